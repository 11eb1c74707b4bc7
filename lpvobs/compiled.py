"""Compiled functions, for which the compiler is loaded when the first of them is called: most verbs that read a file need none.

Until then a function stands in for itself. The first call puts the compiled ones in their place in every module that has them, so
that compiled functions that call each other see nothing else. They divide as NumPy does:
what is over zero is infinite, and no loop waits to ask.
"""

import sys
import threading
from collections.abc import Callable
from functools import update_wrapper
from typing import TYPE_CHECKING, Any

__all__ = ["njit"]
_waiting: list["_Waiting"] = []


class _Waiting:
    """A function that is to be compiled."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]):
        update_wrapper(self, function)
        self.function, self.options = function, options
        self.compiled: Any = None

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function."""
        _load()
        return self.compiled(*arguments)


def _njit(**options: Any) -> Any:
    """Return a decorator like `numba.njit`, which loads Numba when one of the functions is called."""

    def compiled_later(function: Callable[..., Any]) -> Any:
        if "numba" in sys.modules:
            _load()
            return _compiled(function, options)
        _waiting.append(_Waiting(function, options))
        return _waiting[-1]

    return compiled_later


def _compiled(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    import numba  # noqa: PLC0415 takes longer to load than a short verb to run

    return numba.njit(error_model="numpy", **options)(function)


def _load_numba() -> None:
    """Load Numba without SciPy's linear algebra and without cffi, which it looks for although no kernel of a verb needs them.

    That search takes as long as estimating a map. A kernel that does multiply matrices finds SciPy later, when it is compiled.
    """
    looked_for = [name for name in ("scipy.linalg.cython_blas", "cffi") if name not in sys.modules]
    if threading.active_count() == 1:  # no other thread may miss them meanwhile
        sys.modules.update(dict.fromkeys(looked_for))  # type: ignore[arg-type]
    try:
        import numba.core.typing.cffi_utils  # noqa: PLC0415
        import numba.np.arraymath  # noqa: F401, PLC0415
    finally:
        for name in looked_for:
            if sys.modules.get(name, ...) is None:
                del sys.modules[name]


def _load() -> None:
    """Compile what waits, and put it in its place in every module."""
    if not _waiting:
        return
    if "numba" not in sys.modules:
        _load_numba()
    for each in _waiting:
        each.compiled = _compiled(each.function, each.options)
    _waiting.clear()
    package = __name__.partition(".")[0]
    for module in [module for name, module in sys.modules.items() if name.partition(".")[0] == package]:
        for name, value in list(vars(module).items()):
            if isinstance(value, _Waiting):
                setattr(module, name, value.compiled)


if TYPE_CHECKING:  # the checker takes compiled functions as Numba's
    from numba import njit
else:
    njit = _njit
