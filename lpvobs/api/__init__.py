"""The verbs as functions: what the command line does, from Python, with the same files and the same errors.

`lpvobs.NAME` is the function NAME of `lpvobs/api/NAME.py` (`ELSEWHERE` in `lpvobs` says which are not), and a verb of the command
line is one call of it. A module has the function at its top and its work below; what several share has modules of its own. Files
are claimed while they are written, so that two programs do not write the same one, and appear whole or not at all. What fails
raises a class of `lpvobs.errors`: `UsageError` (the configuration or the arguments), `DataError` (a log, gain or result),
`NotProven` (a certificate or a gate), each with one line that names the remedy.

`progress`, where a function takes one, is called with the fraction done, 0 to 1. `jobs` above 1 starts processes that import the
main module: keep the calls under `if __name__ == "__main__":` then. A number is the same to the last bit as that of the command
line if the linear algebra runs on one thread: `OPENBLAS_NUM_THREADS=1`, set before NumPy is imported.

The functions of `ingest`, `profile` and `report` are called `ingest_log`, `draft_profile` and `write_report`: `lpvobs.ingest` and
`lpvobs.report` are rooms of the package.
"""
