"""Functions that take a float without numpy (the emulator) or an array with it (analysis): same code, same result."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypeAlias, cast, overload

from linkrover.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]
    Values: TypeAlias = float | Array

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0


def is_number(value: object) -> bool:
    """A plain number, not an array."""
    return isinstance(value, (float, int))


@overload
def log10(value: float) -> float: ...
@overload
def log10(value: Array) -> Array: ...
def log10(value: Values) -> Values:
    """Decimal logarithm; of 0 it is minus infinity."""
    if is_number(value):
        number = cast("float", value)
        return math.log10(number) if number > 0 else -math.inf
    import numpy as np

    with np.errstate(divide="ignore"):
        return cast("Array", np.log10(value))


def log2(value: Values) -> Values:
    """Binary logarithm."""
    return log10(value) / math.log10(2.0)


def where(condition: Any, yes: Values, no: Values) -> Values:
    """`yes` where the condition holds, else `no`."""
    if isinstance(condition, bool):
        return yes if condition else no
    import numpy as np

    return cast("Array", np.where(condition, yes, no))


def least(a: Values, b: Values) -> Values:
    """The smaller, element by element."""
    return where(a < b, a, b)


def dbm_to_mw(dbm: Values) -> Values:
    """Power in milliwatts."""
    return cast("Values", 10.0 ** (dbm / 10.0))


def mw_to_dbm(mw: Values) -> Values:
    """Power in dBm; nothing is minus infinity."""
    return 10.0 * log10(mw)


def require_positive(where_: str, **values: float) -> None:
    """Raises ConfigError naming the key unless all values are finite and above 0."""
    for key, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise ConfigError(f"{where_}.{key} = {value}: must be above 0")


def require_not_negative(where_: str, **values: float) -> None:
    """Raises ConfigError naming the key unless all values are finite and 0 or more."""
    for key, value in values.items():
        if not (math.isfinite(value) and value >= 0):
            raise ConfigError(f"{where_}.{key} = {value}: must be 0 or more")


def require_finite(where_: str, **values: float) -> None:
    """Raises ConfigError naming the key unless all values are finite."""
    for key, value in values.items():
        if not math.isfinite(value):
            raise ConfigError(f"{where_}.{key} = {value}: must be a finite number")


def require_distance(distance_m: Values) -> None:
    """Raises ConfigError unless all distances are above 0."""
    ok = distance_m > 0
    if not (ok if isinstance(ok, bool) else bool(ok.all())):
        raise ConfigError("distance_m: must be above 0 everywhere")
