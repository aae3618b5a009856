"""Pages as their readers have them: their text, and their Python, run block after block."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def run_blocks(path: Path) -> dict[str, object]:
    """Execute every Python block of a Markdown page; give the names that they leave behind."""
    names: dict[str, object] = {"__name__": path.stem}
    text = path.read_text()
    for block in BLOCK.finditer(text):
        line = text.count("\n", 0, block.start(1))
        code = "\n" * line + block.group(1)  # so that a traceback names the line of the page
        exec(compile(code, str(path), "exec"), names)
    return names


def text_of(path: Path | str) -> str:
    """A page of the repository as one line, wherever its own end."""
    return " ".join((ROOT / path).read_text().split())
