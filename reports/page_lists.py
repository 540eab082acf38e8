"""Lists of the page. Every word from outside is escaped; words between backticks are code."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape


def plain_list(lines: Sequence[str]) -> str:
    return f"<ul>{''.join(f'<li>{_words(line)}</li>' for line in lines)}</ul>"


def named_list(lines: Sequence[tuple[str, str]]) -> str:
    return f"<ul>{''.join(f'<li><b>{_words(name)}</b> {_words(text)}</li>' for name, text in lines)}</ul>"


def _words(text: str) -> str:
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(text))
