"""Whether a photo shows a film, whether it is flat already, and how far the result can be trusted."""
