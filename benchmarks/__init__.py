"""What ``hybrid`` is worth: run time against error, light, stability, and the data that it learns from.

Each command, ``python -m benchmarks.NAME``, is a module here; what they share is in the folders. A new method for
``benchmarks.run`` is one small file: ``methods.py`` says how.
"""
