"""The help of every verb as a page: `python tools/verbs.py > build/verbs.md`."""

import click

from lpvobs.cli.main import app


def main() -> None:
    """Print the page."""
    top = click.Context(app, info_name="lpvobs")
    print(f"# Verbs\n\n```text\n{app.get_help(top)}\n```")
    for name, verb in app.commands.items():
        print(f"\n## `lpvobs {name}`\n\n```text\n{verb.get_help(click.Context(verb, info_name=name, parent=top))}\n```")


main()
