"""The whole way from a photo to the flat film, as a sequence of stages that each report what they did and why.

``job`` is what the stages share, ``looks`` what the network sees; ``geometry`` makes its map exact, ``whole_sheet``
finds where the sheet ends, ``doubt`` judges the map, ``finish`` makes the film, and ``rectifier`` runs all of these.
"""

from hybrid.effort import RectifyConfig
from hybrid.pipeline.rectifier import Rectifier, rectify

__all__ = ["Rectifier", "RectifyConfig", "rectify"]
