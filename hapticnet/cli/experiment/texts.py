"""``hapticnet experiment texts``: print what participants read, to change or translate it."""

from typing import Annotated

import typer


def texts(
    language: Annotated[str, typer.Argument(metavar="LANGUAGE", help="A language that is shipped.")] = "en",
) -> None:
    """Print what participants read, consent and instructions included, as a file to change or translate.

    Name the changed file in the plan, by texts = "my-texts.toml".
    """
    from hapticnet.study.texts import shipped

    print(shipped(language), end="")
