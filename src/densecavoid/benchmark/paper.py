"""What the paper reported, to be printed beside what is measured here."""

PAPER_SUCCESS: dict[str, dict[str, float]] = {
    "depth": {"dense-static": 0.26, "random-sparse-ped": 0.73, "dense-ped": 0.55},
    "depth-lidar": {"dense-static": 0.60, "random-sparse-ped": 0.733, "dense-ped": 1.0},
    "densecavoid": {"dense-static": 0.93, "random-sparse-ped": 0.87, "dense-ped": 1.0},
}
"""Success rates of Sathyamoorthy et al., DenseCAvoid (2020), first results table; they fit about 15 trials a cell."""

PAPER_FROZEN: dict[str, dict[str, float]] = {
    "depth": {"robot-freezing:0.5-1.0": 1.0, "robot-freezing:1.0-1.5": 0.53, "robot-freezing:1.5-2.0": 0.27},
    "depth-lidar": {"robot-freezing:0.5-1.0": 1.0, "robot-freezing:1.0-1.5": 0.33, "robot-freezing:1.5-2.0": 0.0},
    "densecavoid": {"robot-freezing:0.5-1.0": 1.0, "robot-freezing:1.0-1.5": 0.05, "robot-freezing:1.5-2.0": 0.0},
}
"""Frozen rates of its second; there the first column is "less than 1.0 m"."""

PAPER_PATH_M: dict[str, dict[str, float]] = {
    "depth": {"random-sparse-ped": 5.5, "dense-ped": 16.3},
    "depth-lidar": {"random-sparse-ped": 5.11, "dense-ped": 15.51},
    "densecavoid": {"random-sparse-ped": 6.39, "dense-ped": 16.87},
}
"""Mean path lengths in metres, from the same table as the success rates."""
