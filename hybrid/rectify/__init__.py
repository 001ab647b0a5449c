"""Classical geometry and light: from the network's maps to the flat film.

``coarse`` turns these maps into a backward map, ``refine`` makes it exact by what ``edges`` and ``grid`` find in the
photo, ``sheet`` and ``margins`` say what sheet that is, ``film`` reads the photo through it and removes the light,
``fusion`` makes one film of several photos, and ``verdict`` says how far to trust a map. They import one way: splines,
edges, grid, coarse, sheet, margins, refine, film, fusion, verdict.

``hybrid.rectify(photo)`` is also the public shortcut. Importing this package sets the attribute of that name to this
module, so the module itself has to answer the call.
"""

import importlib
import sys
from types import ModuleType
from typing import Any


class _CallableRoom(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Rectify one photo; see ``hybrid.pipeline.rectify``."""
        return importlib.import_module("hybrid.pipeline").rectify(*args, **kwargs)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the module by its name, so that another process, as in a pool, imports it."""
        return importlib.import_module, (self.__name__,)


sys.modules[__name__].__class__ = _CallableRoom
