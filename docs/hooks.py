"""What `mkdocs.yml` cannot say: links that lead out of docs/ work where the repository is browsed, and nowhere else."""

from __future__ import annotations

import re
from posixpath import dirname, join, normpath

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

LINK = re.compile(r"(?<!!)\[([^]]*)]\((\.\./[^)\s]*)\)")


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the page with links to files of the repository made plain text, or links to it where `repo_url` is set."""
    folder = dirname(page.file.src_uri)

    def replace(link: re.Match[str]) -> str:
        text, target = link.groups()
        path = normpath(join(folder, target))
        if not path.startswith("../"):
            return link.group()
        return f"[{text}]({config.repo_url.rstrip('/')}/blob/HEAD/{path[3:]})" if config.repo_url else text

    return LINK.sub(replace, markdown)
