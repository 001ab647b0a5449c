"""The flat prints of films: slices, texts and rules in a grid."""
