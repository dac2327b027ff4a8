"""Where tracked people will be in the next seconds, and how far to trust that."""
