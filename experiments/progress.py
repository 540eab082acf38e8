"""Live progress with the remaining time on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Advance = Callable[[int], None]
PLAIN_LINES_EVERY_SECONDS = 5.0


def duration(seconds: float) -> str:
    """1:02:03 or 2:03."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def print_line(line: str, console: Console) -> None:
    """A line as it is: brackets in it are no markup, and it is not broken."""
    console.print(line, markup=False, highlight=False, soft_wrap=True)


def print_path(path: Path, console: Console) -> None:
    """A path as it is."""
    print_line(str(path), console)


@contextmanager
def progress(console: Console, title: str, total: int) -> Iterator[Advance]:
    """Yields a function that is told how many more items are done."""
    if console.is_terminal:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("remaining"),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(title, total=total)
            yield lambda count: bar.advance(task, count)
    else:
        yield _plain(console, title, total)


def _plain(console: Console, title: str, total: int) -> Advance:
    start = time.monotonic()
    done, printed = 0, start

    def advance(count: int) -> None:
        nonlocal done, printed
        done += count
        now = time.monotonic()
        if done >= total or now - printed >= PLAIN_LINES_EVERY_SECONDS:
            elapsed = now - start
            remaining = elapsed / max(done, 1) * (total - done)
            times = f"{duration(elapsed)} elapsed, {duration(remaining)} remaining"
            print_line(f"{title}: {done}/{total}, {times}", console)
            printed = now

    return advance
