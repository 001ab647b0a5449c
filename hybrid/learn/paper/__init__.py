"""The networks of the paper and its baselines: what they predict, their losses, and their recovery."""
