"""What mkdocs.yml leaves to code: navigation from index.md's tables, links, MathML from TeX, mermaid without a CDN.

Browsers render MathML by themselves; the site brings the font with the measures that formulas need, and mermaid's
script. Both are files of the packages named below.
"""

import html
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.utils import get_relative_url

ASSETS = {
    "site/STIXTwoMath.ttf": ("ziamath", "fonts/STIXTwoMath-Regular.ttf"),
    "site/mermaid.js": ("mermaidx", "assets/mermaid.js"),
}


def on_config(config: Any) -> None:
    """Navigation: a group for each table of index.md, pages in its order."""
    index = Path(config.docs_dir, "index.md").read_text(encoding="utf-8")
    tables = re.findall(r"^\| ([a-z ]+) \| \|\n\| --- \| --- \|\n((?:\|.*\n)+)", index, flags=re.MULTILINE)
    groups = [{name.capitalize(): re.findall(r"\]\(([\w/-]+\.md)\)", rows)} for name, rows in tables]
    config.nav = [{"Start": ["index.md"]}, *groups]


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """A page is linked by its title, not by its file's name; a link out of docs/ becomes the file's name."""
    folder, docs = Path(page.file.abs_src_path).parent, Path(config.docs_dir)

    def link(found: re.Match[str]) -> str:
        text, target = found.groups()
        file = (folder / target.partition("#")[0]).resolve()
        if not file.is_relative_to(docs):
            return f"{text} (`{file.relative_to(docs.parent)}`)"
        if text != file.name or not file.is_file():
            return found[0]
        title = file.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")
        return f"[{title}]({target})"

    return re.sub(r"(?<!!)\[([^\]]*)\]\(([^)#:\s][^):\s]*)\)", link, markdown)


def on_page_content(content: str, **_: Any) -> str:
    """TeX to MathML; a diagram gets a frame to scroll in; the roles of docstrings (:class: and the like) go."""
    content = re.sub(r'<pre class="mermaid">.*?</pre>', r'<div class="diagram">\g<0></div>', content, flags=re.DOTALL)
    content = re.sub(r":(?:class|func|meth|mod|attr|data|exc):(?=<code>)", "", content)
    return re.sub(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', _mathml, content, flags=re.DOTALL)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """The script that draws mermaid's diagrams, on pages that have one."""
    script = f'<script src="{get_relative_url("site/mermaid.js", page.url)}"></script>\n</head>'
    return output.replace("</head>", script, 1) if '<pre class="mermaid">' in output else output


def on_post_build(config: Any) -> None:
    """Files that the theme, or a page of MathML, would load from the network or miss."""
    for name, (package, path) in ASSETS.items():
        Path(config.site_dir, name).write_bytes((files(package) / path).read_bytes())


def _mathml(found: re.Match[str]) -> str:
    tex = html.unescape(found[2]).replace("{aligned}", "{align*}")
    mathml = convert(tex, display="block" if found[1] == "div" else "inline")
    bars = r'<mo stretchy="false" lspace="0" rspace="0">\1'  # of | and ||: brackets here, not operators
    mathml = re.sub(r'<mo(?: stretchy="false")?>(&#x0007C;|&#x02016;)', bars, mathml)
    return f'<{found[1]} class="tex">{mathml}</{found[1]}>'
