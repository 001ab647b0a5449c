"""The film as a bent sheet that does not stretch: which one the photo shows."""
