"""What lights a film: rooms, lamps, and how its surface answers."""
