"""Learning: PPO in the paper's curriculum. Needs torch (the extra `train`)."""
