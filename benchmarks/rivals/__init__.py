"""What ``hybrid`` is compared with: a phone's scanner, and the paper's networks run as published."""
