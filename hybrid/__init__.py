"""Photo of a bent, shiny, unevenly lit CT film in, flat print out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from hybrid.errors import ConfigError, FusionError, HybridError, PhotoError
    from hybrid.pipeline import Rectifier, RectifyConfig, rectify
    from hybrid.records import RectifyResult, SliceGrid, StageReport, Status

_PLACES = {
    "ConfigError": "hybrid.errors",
    "FusionError": "hybrid.errors",
    "HybridError": "hybrid.errors",
    "PhotoError": "hybrid.errors",
    "Rectifier": "hybrid.pipeline",
    "RectifyConfig": "hybrid.pipeline",
    "rectify": "hybrid.pipeline",
    "RectifyResult": "hybrid.records",
    "SliceGrid": "hybrid.records",
    "StageReport": "hybrid.records",
    "Status": "hybrid.records",
}
__all__ = [
    "ConfigError",
    "FusionError",
    "HybridError",
    "PhotoError",
    "Rectifier",
    "RectifyConfig",
    "RectifyResult",
    "SliceGrid",
    "StageReport",
    "Status",
    "rectify",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used, so that importing the package costs nothing."""
    if name not in _PLACES:
        raise AttributeError(f"module 'hybrid' has no attribute {name!r}; it has {', '.join(__all__)}")
    import importlib

    return getattr(importlib.import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    """Public names, also those that were not used yet."""
    return sorted({*globals(), *__all__})
