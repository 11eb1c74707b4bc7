"""Calls a compiled function as soon as it is imported: the fork server of `verbs` readies Numba once, not every call for itself.

`verbs` names it as `tests.warm`, which Python finds from the repository's folder; from elsewhere calls take a little longer.
"""

import numpy as np

from lpvobs.maps.grid import share

share(np.array([0.0, 1.0, 2.0]), 1.5, 1)
