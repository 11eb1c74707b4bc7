"""Results that are kept: when a search changes one sensor, most of an engine is asked the same again."""

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from lpvobs.records import Array


class Kept:
    """A function of constants and arrays, with its last results."""

    def __init__(self, function: Callable[..., Any], most: int = 4):
        self._function = function
        self._last: deque[tuple[Any, tuple[Array, ...], Any]] = deque(maxlen=most)

    def __call__(self, constants: Any, *arrays: Array) -> Any:
        """Return what the function makes of them; nobody may write into it."""
        for same, given, result in tuple(self._last):
            if same == constants and all(map(np.array_equal, given, arrays)):
                return result
        result = self._function(constants, *arrays)
        self._last.append((constants, tuple(np.array(x) for x in arrays), result))
        return result
