"""Simulated photos of films with their truth: ``python -m data_gen.generate`` and the commands beside it.

``ct`` holds volumes, ``prints`` prints their slices, ``light``, ``camera`` and ``scene`` draw what a photo shows, and
``render`` computes the light that reaches the camera. Each of these imports only those before it; what makes data sets
of them is beside them.
"""
