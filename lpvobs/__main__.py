"""`python -m lpvobs`: the command line, also where no console script is installed."""

from lpvobs.cli.start import run

if __name__ == "__main__":
    run()
