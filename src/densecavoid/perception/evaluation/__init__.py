"""How well people are found, tracked and predicted: tables and pictures."""
