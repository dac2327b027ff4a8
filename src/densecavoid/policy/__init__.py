"""The policy: networks and distribution (torch), export, and the torch-free runtime and navigator."""
