"""Splines over the film's plane, and the smooth displacement that observations of the film call for."""
