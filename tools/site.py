"""The documentation site: `python -m tools.site`, or `make site`, writes build/site.

Pages are the Markdown and the notebooks under docs/, and README as the first one. This module adds
the site's own parts: notebooks as pages, links between the two places, and a reference of all
commands.
"""

import base64
import functools
import json
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parents[1]
BESIDE = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "LICENSE")  # pages outside docs/
# A table or a list right below other text, which GitHub takes for one and Markdown of old does not.
_BLOCK = re.compile(
    r"^((?![|\s]|[-*] |\d+\. ).+\n)(\|.*\n\|[-:| ]+\|$|(?:[-*]|1\.) )", re.MULTILINE
)
_PAGES = "<!-- pages -->"  # where links to the pages of tasks stand, on the front page a film too
_FILMED = "gentle_scratch/dagger-ego-s0", "gentle_scratch/person-20042"
_FILM = """<iframe src="film.html" title="A film of an episode" class="film"></iframe>

*A robot of the zoo with a person that it never met. Turn it with the pointer.* """
_FETCHED = {"script": "src", "img": "src", "source": "src", "video": "src", "iframe": "src"}


def build(out: Path = ROOT / "build") -> Path:
    """Write the pages to `out`/docs and the site to `out`/site; return the site's folder.

    Raises:
        ValueError: A link leads nowhere, or a page would fetch something from elsewhere.
    """
    if problems := find_dead_links():
        raise ValueError("\n".join(problems))
    _write_pages(out / "docs")
    settings = out / "zensical.toml"  # its folders are relative to itself
    text = (ROOT / "zensical.toml").read_text(encoding="utf-8")
    settings.write_text(text.replace('"build/', '"').replace('["."]', json.dumps([str(ROOT)])))
    shutil.rmtree(out / "site", ignore_errors=True)
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean", "-f", settings]
    done = subprocess.run(command, capture_output=True, text=True, cwd=out)
    if done.returncode:
        output = (done.stdout + done.stderr).partition("Traceback")[0]
        raise ValueError(re.sub(r"\x1b\[[\d;]*m", "", output))
    if problems := find_problems(out / "site"):
        raise ValueError("\n".join(problems))
    return out / "site"


def notebook_page(notebook: dict[str, Any], name: str, folder: Path) -> str:
    """Return a notebook as Markdown; its pictures are written to `folder`/images/`name`-N.png."""
    parts, pictures = [], 0
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                pictures += 1
                path = folder / "images" / f"{name}-{pictures}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(base64.b64decode(data["image/png"]))
                parts.append(f"![Output of the cell above](images/{path.name})")
            elif "text/html" in data:  # without blank lines it is one block of HTML
                html = re.sub(r"\n\s*\n", "\n", "".join(data["text/html"]))
                parts.append(f'<div style="overflow-x: auto">\n{html}\n</div>')
            else:
                text = "".join(output.get("text") or data.get("text/plain", ""))
                parts.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(parts) + "\n"


def find_dead_links(root: Path = ROOT) -> list[str]:
    """Return messages for relative links of Markdown files that lead to no file.

    The check of built pages misses files that are no pages, such as those of docs/data.
    """
    folders = ("docs", "board", "workshop", "packages", "tests/outside", ".github")
    files = [
        *root.glob("*.md"),
        *(path for name in folders for path in (root / name).rglob("*.md")),
    ]
    problems = []
    for path in sorted(files):
        text = re.sub(r"^```.*?^```", "", path.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
        for found in re.finditer(r'\]\(([^()\s]+)\)|src="([^"]+)"', text):
            link = urlsplit(found[1] or found[2])
            if not (link.scheme or link.netloc or (path.parent / unquote(link.path)).exists()):
                problems.append(
                    f"{path.relative_to(root)} links to {link.path}, which is not there"
                )
    return problems


def find_problems(site: Path) -> list[str]:
    """Return messages for dead links, and for content fetched from elsewhere, in built pages."""
    pages = {path: _Page(path) for path in sorted(site.rglob("*.html"))}
    problems = []
    for path, page in pages.items():
        name = path.relative_to(site)
        problems += [f"{name} fetches {url}" for url in page.fetched if urlsplit(url).netloc]
        for url in (*page.links, *page.fetched):
            parts = urlsplit(url)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                problems.append(f"{name} links to {url}, which is not there")
            elif parts.fragment and unquote(parts.fragment) not in pages[target].anchors:
                problems.append(f"{name} links to {url}, which has no such place")
    return problems


class _Page(HTMLParser):
    """Links, fetched addresses and anchors of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.anchors: set[str] = set()
        self._is_error_page = path.name == "404.html"  # which is shown at any address
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {name: value or "" for name, value in attrs}
        self.anchors |= {attributes[name] for name in ("id", "name") if name in attributes}
        if self._is_error_page:
            return
        if tag == "a" and attributes.get("href"):
            self.links.append(attributes["href"])
        if tag == "link" and attributes.get("rel") not in ("canonical", "next", "prev"):
            self.fetched.append(attributes["href"])
        if attributes.get(_FETCHED.get(tag, "")):
            self.fetched.append(attributes[_FETCHED[tag]])


def _write_pages(folder: Path) -> None:
    """Write all pages of the site as Markdown to a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT / "docs", folder, ignore=shutil.ignore_patterns("data"))
    for path in sorted(folder.glob("*.ipynb")):
        notebook = json.loads(path.read_text(encoding="utf-8"))
        path.with_suffix(".md").write_text(notebook_page(notebook, path.stem, folder))
        path.unlink()
    for name in BESIDE:
        shutil.copy(ROOT / name, folder)
    (folder / "commands.md").write_text(_commands())
    (folder / "film.html").write_bytes(_film())
    links = _play_pages(folder / "play")
    for name, source, live in (
        ("play.md", folder / "play.md", f"Play now: {links}."),
        ("index.md", ROOT / "README.md", f"{_FILM}Or be the person yourself, now: {links}."),
    ):
        (folder / name).write_text(source.read_text("utf-8").replace(_PAGES, live))
    for path in folder.rglob("*.md"):
        up = "../" * (len(path.relative_to(folder).parts) - 1)
        path.write_text(_relink(path.read_text(encoding="utf-8"), up))


def _relink(text: str, up: str = "") -> str:
    """Return a page's text with links that fit the site, and with pictures that link to themselves.

    The site has docs/ and the pages beside it in one folder; `up` leads to it from the page's.
    """
    text = re.sub(rf'(\]\(|src="){up}(?:docs/|\.\./)', rf"\1{up}", text)
    text = re.sub(r"(\]\((?:\.\./)*)README\.md", r"\1index.md", text)
    text = _BLOCK.sub(r"\1\n\2", text)
    # On a phone a picture is read at its own size, one touch away.
    text = re.sub(r"^(!\[[^\]]*\]\(([^)]+)\))$", r"[\1](\2)", text, flags=re.MULTILINE)
    text = re.sub(r'(<img src="([^"]+)"[^>]*>)', r'<a href="\2">\1</a>', text)
    return re.sub(r"(\]\([\w./-]+)\.ipynb([)#])", r"\1.md\2", text)


def _play_pages(folder: Path) -> str:
    """Write the page of each task on which a visitor is the person; return links to them."""
    from evaluation.seat.modules import playable
    from evaluation.seat.page import default_robots, network_of, published, write_page
    from zoo.registry import load_registry

    folder.mkdir()
    registry, links = load_registry(), []
    for task in playable():
        network = network_of(task)
        robots = published(registry, default_robots(registry, task, network), network)
        write_page(task, robots, folder / f"{task}.html")
        links.append(f"[{task.removeprefix('gentle_')}](play/{task}.html)")
    return ", ".join(links)


@functools.cache
def _film() -> bytes:
    """Return a page that plays an episode of a robot with a person."""
    from assistax_zoo.commands.evaluation.watch import watch

    with tempfile.TemporaryDirectory() as folder:
        watch(*_FILMED, out=Path(folder) / "film.html")
        return (Path(folder) / "film.html").read_bytes()


def _commands() -> str:
    """Return the reference of the command line: each command's help and example."""
    from assistax_zoo.shell.main import _add_subcommands, _complete_help, all_commands, build_app

    app = build_app()
    for command in {name.partition(".")[0] for name in all_commands() if "." in name}:
        _add_subcommands(app, [command])
    page = app.generate_docs(heading_level=1, max_heading_level=3)
    # The list of commands is a table of contents already, and an empty default says nothing.
    page = re.sub(r"^## Table of Contents\n\n(?:\s*- .*\n)+\n", "", page, flags=re.MULTILINE)
    page = page.replace("*[default: ()]*", "").replace("*[default: *]*", r"*[default: \*]*")
    page = page.replace("# assistax-zoo", "# All commands", 1)
    # This one is named as the program that runs, which here is this module.
    page = re.sub(r"(--install-completion) .*(\[OPTIONS\])", r"\1 \2", page)
    parts = re.split(r"^(?=##+ assistax-zoo )", page, flags=re.MULTILINE)
    for i, part in enumerate(parts[1:], 1):
        words = part.partition("\n")[0].split()[2:]
        _complete_help(app, words)
        example = app.parse_commands(words)[1][-1].help_epilogue or ""
        lines = textwrap.dedent(example.partition("\n\n")[2])
        lines = re.sub(r"\n(?!assistax-zoo )", r" \\\n    ", lines)
        parts[i] = part + (f"**Example**:\n\n```sh\n{lines}\n```\n\n" if lines else "")
    return "".join(parts)


if __name__ == "__main__":
    print(build())
