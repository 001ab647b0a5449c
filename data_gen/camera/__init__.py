"""Where the phone is held, and what its camera makes of the light."""
