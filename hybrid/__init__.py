"""Photo of a bent, shiny, unevenly lit CT film in, flat print out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from hybrid.backward import BackwardMap, Orientation
    from hybrid.effort import Effort
    from hybrid.errors import ConfigError, DataError, FusionError, HybridError, PhotoError
    from hybrid.grid_edit import GridEdit
    from hybrid.outputs import save_result
    from hybrid.pipeline import Rectifier, RectifyConfig, rectify
    from hybrid.records import LeftOut, RectifyResult, Signs, SliceGrid, StageReport, Status, StatusCode

_PLACES = {
    "BackwardMap": "hybrid.backward",
    "Orientation": "hybrid.backward",
    "Effort": "hybrid.effort",
    "ConfigError": "hybrid.errors",
    "DataError": "hybrid.errors",
    "FusionError": "hybrid.errors",
    "GridEdit": "hybrid.grid_edit",
    "HybridError": "hybrid.errors",
    "PhotoError": "hybrid.errors",
    "save_result": "hybrid.outputs",
    "Rectifier": "hybrid.pipeline",
    "RectifyConfig": "hybrid.pipeline",
    "rectify": "hybrid.pipeline",
    "LeftOut": "hybrid.records",
    "RectifyResult": "hybrid.records",
    "Signs": "hybrid.records",
    "SliceGrid": "hybrid.records",
    "StageReport": "hybrid.records",
    "Status": "hybrid.records",
    "StatusCode": "hybrid.records",
}
__all__ = [
    "BackwardMap",
    "ConfigError",
    "DataError",
    "Effort",
    "FusionError",
    "GridEdit",
    "HybridError",
    "LeftOut",
    "Orientation",
    "PhotoError",
    "Rectifier",
    "RectifyConfig",
    "RectifyResult",
    "Signs",
    "SliceGrid",
    "StageReport",
    "Status",
    "StatusCode",
    "rectify",
    "save_result",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used, so that importing the package costs nothing."""
    if name not in _PLACES:
        raise AttributeError(f"module 'hybrid' has no attribute {name!r}; it has {', '.join(__all__)}")
    import importlib

    return getattr(importlib.import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    """Public names, including those not used yet."""
    return sorted({*globals(), *__all__})
