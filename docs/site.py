"""What mkdocs does to the pages of the site: it adds the options, and takes away links that lead out of docs/."""

import re
from typing import Any, Final

import typer.main
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from typer.cli import get_docs_for_click

from hapticnet.cli import app

OUTSIDE: Final = re.compile(
    r"\[([^]]*)\]\((?:\.\./)+(?:examples|extras|studies|hapticnet|firmware|peers|tests|CONTRIBUTING|CHANGELOG)[^)]*\)"
)
"""A link to a file of the repository that is not a page."""

EXAMPLES: Final = re.compile("\x08\nExamples:\n((?:.+\n)*)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page of all commands and options, from the command line itself."""
    command: Any = typer.main.get_command(app)
    context = command.make_context("hapticnet", [], resilient_parsing=True)
    text = get_docs_for_click(obj=command, ctx=context, name="hapticnet", title="Commands and options")
    text = EXAMPLES.sub(r"**Examples**:\n\n```console\n\1```\n", text)
    files.append(File.generated(config, "refer/options.md", content=text))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Show what is linked in the repository, but not on the site, as text."""
    return OUTSIDE.sub(r"\1", markdown)
