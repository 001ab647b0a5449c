"""What the networks make of a photo or of a flat film."""
