"""Observer gains: synthesised and proven, proven again."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from lpvobs.api.files import File, as_path, as_paths, writing
from lpvobs.errors import NotProven, UsageError

if TYPE_CHECKING:
    from lpvobs.io.results.gains import StoredGain
    from lpvobs.synthesis.certificate import Certificate


def synth_gain(
    config: File, logs: File | Iterable[File] = (), *, out: File, published: str | None = None
) -> "StoredGain":
    """Find the observer gain from the linear matrix inequalities of Theorem 1, prove it, and write it.

    Parameters
    ----------
    config : path
    logs : path or several
        Logs, patterns or folders whose range of the scheduling parameters the gain is to cover; none: `[gain.bounds]` of the
        configuration.
    out : path
        The gain file to write.
    published : str, optional
        `ETC`, `FTP75` or `NEDC`: the paper's own L of Eq. (38), proven on that column of Table 1.

    Returns
    -------
    StoredGain
        `gain.L` of shape (3, r), r outputs with the sensor last, in the units of the states per unit of the outputs and second;
        `gain.certificate`, and `gain.region` that it holds on.

    Raises
    ------
    NotProven
        If no gain can be proven.
    UsageError, DataError
        If the configuration or a log cannot be used.

    Notes
    -----
    Eq. (27), (28) and (33). Departure from the paper: p_em is a fourth output by default, see `docs/method.md`.
    """
    from lpvobs.io.configuration.config import load_config
    from lpvobs.io.results.gains import write_gain
    from lpvobs.io.results.provenance import Provenance
    from lpvobs.api.gain import make_gain, make_published_gain

    paths = as_paths(logs)
    if published is not None and paths:
        raise UsageError("published: takes no logs, its region is a column of Table 1; drop one of them")
    with writing(as_path(out), [as_path(config), *paths]) as target:
        configuration, text = load_config(as_path(config))
        if published is None:
            stored, digests = make_gain(configuration, paths)
        else:
            stored, digests = make_published_gain(configuration, published), {}
        write_gain(target, stored, Provenance(digests, text))
    return stored


def verify(gain: File) -> "Certificate":
    """Prove a stored gain again in rational arithmetic, without the solver, and return the certificate.

    Raises
    ------
    NotProven
        If the stored numbers do not prove Theorem 1 on the stored region.
    DataError
        If the file cannot be used.
    """
    from lpvobs.io.results.gains import read_gain
    from lpvobs.api.gain import check_again

    certificate = check_again(read_gain(as_path(gain)))
    if not certificate.proven:
        raise NotProven(f"{gain}: not proven: {certificate.reason}; make the gain again with synth_gain")
    return certificate
