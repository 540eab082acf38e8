"""Draws the pictures of docs/sequences.md and prints its tables: `python docs/sequence_figures.py [FILE.csv]`.

Given the recording, its statistics are written to docs/data/recording_statistics.json; otherwise they are read from it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from data_figures import sheet
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from reports.camera import look
from reports.colors import method_color
from reports.figures import STYLE
from retarget.types import FloatArray
from synth_data.arkit import SKIN_NAMES
from synth_data.conversation import conversation
from synth_data.live_link import read_live_link
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import personal_rig
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head
from synth_data.recording import Recording
from synth_data.weight_statistics import correlations, dimensions, spectrum, speeds, statistics, unexplained
from synth_data.weights import blending_weights

HERE = Path(__file__).parent
IMAGES, STORED = HERE / "images", HERE / "data" / "recording_statistics.json"
SOURCE = "alex_rom_3, a range-of-motion take of Live Link Face, (c) 2021 A. Donciu-Julin, MIT licence"
RECORDING, CONVERSATION = method_color(0), method_color(1)
PEOPLE, EXPRESSIONS, SECONDS = 4, 250, 600
EXAMPLES = (1, 2, 3, 5, 8, 12, 15, 20, 25, 30, 40, 50)
SHOWN = (5, 15, 30)  # examples of the studies
SPEEDS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999)  # quantiles
Summary = Mapping[str, Any]


def summary(take: Recording) -> Summary:
    """What the pictures show of a take."""
    frequency, power = spectrum(take)
    weights = take.skin
    return {
        "statistics": {name: round(value, 4) for name, value in statistics(take).items()},
        "frequency": frequency[1:].round(3).tolist(),
        "power": (power[1:] / power[1:].sum()).round(7).tolist(),
        "speeds": np.quantile(speeds(take), SPEEDS).round(3).tolist(),
        "median": dict(zip(SKIN_NAMES, np.median(weights, axis=0).round(3).tolist(), strict=True)),
        "high": dict(zip(SKIN_NAMES, np.quantile(weights, 0.95, axis=0).round(3).tolist(), strict=True)),
        "correlations": correlations(weights).round(2).tolist(),
    }


def span(weights: FloatArray, gram: FloatArray) -> Summary:
    """How much of the face the expressions of a source span."""
    return {
        "weights": dimensions(weights),
        "vertices": dimensions(weights, gram),
        "unexplained": [round(unexplained(weights, gram, k), 4) for k in EXAMPLES],
    }


def draw_statistics(recorded: Summary, generated: Summary, path: Path) -> None:
    """Units, spectrum, speeds and correlations of the recording beside those of the conversation."""
    both = ((recorded, RECORDING, "recording"), (generated, CONVERSATION, "conversation"))
    figure = Figure(figsize=(7.6, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(3, 2, height_ratios=(1.15, 0.95, 1.45))
    units: Axes = figure.add_subplot(grid[0, :])
    place = np.arange(len(SKIN_NAMES))
    for (take, color, name), shift in zip(both, (-0.2, 0.2), strict=True):
        low, high = ([take[key][unit] for unit in SKIN_NAMES] for key in ("median", "high"))
        units.vlines(place + shift, low, high, color=color, linewidth=2.2, label=f"{name}: median to 95 %")
    units.set(xlim=(-0.8, len(place) - 0.2), ylim=(-0.02, 1), ylabel="weight", xticks=place)
    units.set_xticklabels(SKIN_NAMES, rotation=90, fontsize=6)
    units.legend(frameon=False, loc="upper right", ncols=2)

    power: Axes = figure.add_subplot(grid[1, 0])
    rate: Axes = figure.add_subplot(grid[1, 1])
    for take, color, name in both:
        power.loglog(take["frequency"], take["power"], color=color, label=name)
        rate.plot(take["speeds"], 1 - np.array(SPEEDS), color=color, marker="o", markersize=3, label=name)
    power.set(xlabel="frequency (Hz)", ylabel="share of the power", xlim=(0.1, 15), ylim=(1e-6, 0.6))
    rate.set(xlabel="speed of a unit (1 / s)", ylabel="share of the frames above", yscale="log", xlim=(0, None))
    for axes in (power, rate):
        axes.legend(frameon=False)

    for column, (take, _, name) in enumerate(both):
        axes = figure.add_subplot(grid[2, column])
        image = axes.imshow(take["correlations"], cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
        starts = [i for i, unit in enumerate(SKIN_NAMES) if _part(unit) != _part(SKIN_NAMES[i - 1])]
        axes.set(title=f"correlations, {name}", xticks=[], yticks=[i - 0.5 for i in starts])
        axes.set_yticklabels([_part(SKIN_NAMES[i]) for i in starts], va="top")
        axes.spines[:].set_visible(False)
    figure.colorbar(image, ax=figure.axes[-2:], shrink=0.7, aspect=30, pad=0.01).outline.set_visible(False)
    figure.savefig(path, dpi=150)


def draw_spans(spans: Mapping[str, Summary], path: Path) -> None:
    """What linear blends of so many examples cannot reach."""
    figure = Figure(figsize=(6.2, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Axes = figure.add_subplot()
    for i, (name, found) in enumerate(spans.items()):
        style = "--" if "range of motion" in name else "-"
        axes.plot(EXAMPLES, 100 * np.array(found["unexplained"]), style, color=method_color(i), label=name)
    for k in SHOWN:
        axes.axvline(k, color="#bbbbbb", linewidth=0.7, zorder=0)
    axes.set(xlabel="examples", ylabel="motion out of reach of linear blends (%)", xlim=(0, 51), ylim=(0, 100))
    axes.set_xticks([*SHOWN, 40, 50])
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def draw_heads(poses: Mapping[str, FloatArray], rig: FloatArray, neutral: FloatArray, faces: Any, path: Path) -> None:
    """Rows of eight heads: weights (8, 51) by the name of their row."""
    fine = subdivide(faces, len(neutral), 1)
    heads = [fine(neutral + np.tensordot(w, rig, axes=1)) for weights in poses.values() for w in weights]
    y, z = heads[0][:, 1:].T
    face = (y > 608) & (y < 785) & (z > 35)
    size = (230, 260)
    camera = look(np.stack(heads)[:, face], size, turn=22, raise_=2, margin=0.01)
    labels = [f"{name} {i}" for name, weights in poses.items() for i in range(len(weights))]
    sheet(path, heads, fine.faces, labels, camera, size)


def _part(unit: str) -> str:
    return next(part for part in ("brow", "cheek", "eye", "jaw", "mouth", "nose") if unit.startswith(part))


def main(files: list[str]) -> None:
    head, targets = load_head(progress=print)
    regions = load_regions()
    people = [IdentitySampler(head, targets, regions)(seed) for seed in range(PEOPLE)]
    rigs = [personal_rig(person, head, targets, regions) for person in people]
    moved = np.concatenate([rig[:, regions.vertices["face"]].reshape(len(SKIN_NAMES), -1) for rig in rigs], axis=1)
    gram = moved @ moved.T

    take = conversation(SECONDS)
    sets = {
        "sparse": blending_weights("sparse", EXPRESSIONS),
        "recombined, conversation": blending_weights("recombined", EXPRESSIONS),
        "recorded, conversation": blending_weights("recorded", EXPRESSIONS),
    }
    if files:
        recording = read_live_link(files[0])
        spans = {
            f"{s}, range of motion": span(blending_weights(s, EXPRESSIONS, 0, recording), gram)
            for s in ("recombined", "recorded")
        }
        stored = {"source": SOURCE} | dict(summary(recording)) | {"spans": spans}
        lines = (f"  {json.dumps(key)}: {_lines(value)}" for key, value in stored.items())
        STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    stored = json.loads(STORED.read_text())
    spans = {name: span(weights, gram) for name, weights in sets.items()} | stored["spans"]

    generated = summary(take)
    for name, value in stored["statistics"].items():
        print(f"| {name} | {value:.3g} | {generated['statistics'][name]:.3g} |")
    columns = [EXAMPLES.index(k) for k in SHOWN]
    for name, found in spans.items():
        sizes = " | ".join(" / ".join(map(str, found[key])) for key in ("weights", "vertices"))
        shares = " | ".join(f"{100 * found['unexplained'][i]:.0f} %" for i in columns)
        print(f"| {name} | {sizes} | {shares} |")

    with matplotlib.rc_context(STYLE):
        draw_statistics(stored, generated, IMAGES / "sequences_statistics.png")
        draw_spans(spans, IMAGES / "sequences_span.png")
    poses = {name.split(",")[0]: weights[:8] for name, weights in sets.items()}
    talking = _first_speech(take.skin)
    poses["talking"] = take.skin[talking : talking + 24 : 3]  # every 0.1 s
    draw_heads(poses, rigs[0], people[0].vertices, head.faces, IMAGES / "sequences_heads.png")


def _first_speech(weights: FloatArray) -> int:
    """The first frame with an open mouth."""
    return int(np.argmax(weights[:, SKIN_NAMES.index("jawOpen")] > 0.2))


def _lines(value: Any) -> str:
    """JSON with a row of a matrix in a line."""
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n    " + ",\n    ".join(map(json.dumps, value)) + "\n  ]"
    return json.dumps(value)


if __name__ == "__main__":
    main(sys.argv[1:])
