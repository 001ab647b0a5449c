"""The errors that a user can meet: each says what and where, what it got, what is allowed, and what to do next."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from numbers import Integral, Real
from typing import Any, NoReturn
from zipfile import BadZipFile

NPZ_ERRORS = (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error)
"""What NumPy raises where an .npz file is damaged or lacks an array."""


class HybridError(Exception):
    """Base of every error that this package raises on purpose."""


class PhotoError(HybridError):
    """A photo that cannot be read or is not an image the pipeline can take."""


class DataError(HybridError):
    """A data file (shard, CT volume, DICOM series, environment, weights) that cannot be used."""


class ConfigError(HybridError):
    """An option, or a combination of options, that is not allowed."""


class FusionError(HybridError):
    """Photos that cannot be fused into one film."""


class SimulationError(HybridError):
    """A simulated state that cannot be reached, with the residual that was left."""


def describe(*, what: str, where: object = None, got: object = None, allowed: object = None, do: str) -> str:
    """One readable sentence from the five parts that every message has."""
    head = f"{what} ({where})" if where is not None else what
    body = [f"got {got}" if got is not None else "", f"allowed: {allowed}" if allowed is not None else ""]
    facts = "; ".join(part for part in body if part)
    return f"{head}: {facts}. {do}" if facts else f"{head}. {do}"


def told(error: Exception, where: object = None) -> str:
    """An error as a sentence; the system's own errors say only why, and not always ``where``."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error) or type(error).__name__
    do = "Mend that (free space, permissions, names) and run the same command again."
    file = error.filename2 or error.filename or where
    return describe(what="A file cannot be read or written", where=file, got=error.strerror, do=do)


def install_extra(extra: str) -> str:
    """What to do if a package is missing that only an installation with an extra has."""
    return f"Install the package with its extra for that: pip install '.[{extra}]' in the project's folder."


def require_at_least(config: Any, least: int | float, *names: str) -> None:
    """Refuse options, numbers or tuples of them, that are below a minimum.

    Raises:
        ConfigError: one is, or is empty or not a number.
    """
    _require(config, lambda each: each >= least, f">= {least:g}", names)


def require_at_most(config: Any, most: int | float, *names: str) -> None:
    """The same for options above a maximum."""
    _require(config, lambda each: each <= most, f"<= {most:g}", names)


def _require(config: Any, fits: Callable[[Any], bool], allowed: str, names: Sequence[str]) -> None:
    for name in names:
        value = getattr(config, name)
        values = value if isinstance(value, tuple) else (value,)
        if not values or not all(isinstance(each, Real) and fits(each) for each in values):
            _refuse(config, name, value, allowed)


def _refuse(config: Any, name: str, value: Any, allowed: str) -> NoReturn:
    option = f"{type(config).__name__}.{name}"
    raise ConfigError(describe(what=option, got=repr(value), allowed=allowed, do="Choose another."))


class FittedWeights:
    """Options that are weights of a sum, which may have either sign."""


def require_numbers(config: Any) -> None:
    """Refuse invalid options, in a record of options and in those within it: a nested record of another kind; what is
    not a number, or not a whole one, where the default is; NaN, with which no comparison holds; and numbers below 0,
    except for fitted weights and options whose defaults are: sizes, counts and shares are not.

    Raises:
        ConfigError: one is.
    """
    for one in fields(config):
        value, usual = getattr(config, one.name), _usual(one)
        if is_dataclass(usual):
            if not isinstance(value, type(usual)):
                _refuse(config, one.name, value, f"a {type(usual).__name__}")
            require_numbers(value)
            continue
        if not _is_alike(value, usual):
            _refuse(config, one.name, value, _told_kind(usual))
        signed = isinstance(config, FittedWeights) or (isinstance(usual, float) and usual < 0)
        values = value if isinstance(value, tuple) else (value,)
        if any(isinstance(each, (int, float)) and not each >= (-math.inf if signed else 0) for each in values):
            _refuse(config, one.name, value, "numbers" if signed else ">= 0")


def _is_alike(value: Any, usual: Any) -> bool:
    """Whether a value is of the kind of the usual one: yes or no, a whole number, a number, or a tuple of them."""
    if isinstance(usual, tuple):
        if not isinstance(value, tuple):
            return False
        return all(map(_is_alike, value, usual if len(usual) == len(value) else usual[:1] * len(value)))
    if isinstance(usual, bool):
        return isinstance(value, bool)
    if isinstance(usual, int):
        return isinstance(value, Integral)
    return isinstance(value, Real) or not isinstance(usual, float)


def _told_kind(usual: Any) -> str:
    """The kind that ``_is_alike`` asks for, in words."""
    if isinstance(usual, tuple):
        return "a tuple of numbers" if any(isinstance(each, float) for each in usual) else "a tuple of whole numbers"
    if isinstance(usual, bool):
        return "True or False"
    return "a whole number" if isinstance(usual, int) else "a number"


def _usual(option: Field[Any]) -> Any:
    """The default value of an option; None if it must be given."""
    if option.default_factory is not MISSING:
        return option.default_factory()
    return None if option.default is MISSING else option.default
