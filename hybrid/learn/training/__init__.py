"""The trainer, and what it can train."""
