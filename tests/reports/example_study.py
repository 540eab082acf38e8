"""A small results folder as `experiments run` writes it, without running a method."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import trimesh

from reports.cells import METRIC_COLUMNS
from reports.summary import summarise

METHODS = {  # error as a share of the motion at 5, 15, 30 examples
    "delta": (0.42, 0.42, 0.42),
    "sumner_popovic": (0.45, 0.44, 0.45),
    "lbs": (0.38, 0.16, 0.08),
    "plbs": (0.24, 0.11, 0.06),
    "plbs_residual": (0.20, 0.105, 0.058),
}
REFERENCES = {"neutral": (1.0, 1.0, 1.0), "projection_bound": (0.15, 0.05, 0.02)}
COUNTS = (5, 15, 30)
FAMILY = ["delta", "sumner_popovic", "lbs"]
FAILED = ("lbs", 5)  # fails in one pair
UNSUPPORTED = ("sumner_popovic", 30)  # serves no pair


def ball(subdivisions: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """A head-sized egg: (n, 3) mm, (f, 3)."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(sphere.vertices) * [75.0, 110.0, 95.0], np.asarray(sphere.faces)


def write_example_study(
    folder: Path,
    identities: int = 4,
    draws: int = 2,
    noise_mm: float = 0.0,
    schema: int = 1,
    head: tuple[np.ndarray, np.ndarray] | None = None,
    failures: bool = True,
    seed: int = 0,
) -> Path:
    """Write study.json, metrics, cells, summary and the frames of one pair; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    base, faces = ball() if head is None else head
    names = [f"person_{i:02d}" for i in range(identities)]
    expressions = [f"expression_{i:03d}" for i in range(5)]
    low = base[:, 1].min()
    head_region = np.flatnonzero(base[:, 1] > low + 0.12 * np.ptp(base[:, 1]))
    regions = {
        "head": head_region,
        "lips": head_region[(np.abs(base[head_region, 1]) < 40) & (base[head_region, 2] > 0)],
        "brows": head_region[base[head_region, 1] > 20],
        "jaw_skin": head_region[base[head_region, 1] < 0],
    }
    neutral = {name: base * (1 + 0.05 * rng.normal(size=3)) for name in names}
    fields = [_bumps(base, rng) for _ in expressions]
    strength = {name: 1 + 0.2 * rng.normal() for name in names}
    patterns = {name: _bumps(base, rng, 6, 1.0) for name in (*METHODS, *REFERENCES)}
    conditions = {
        "dataset": "example",
        "truth": "personal_blendshapes",
        "weights": "sparse",
        "noise_mm": noise_mm,
        "correspondence": "given",
    }
    metric_rows: list[dict[str, Any]] = []
    cells: list[dict[str, Any]] = []
    pairs = list(itertools.permutations(names, 2))
    for (source, target), (method, errors), (i, count), draw in itertools.product(
        pairs, {**METHODS, **REFERENCES}.items(), enumerate(COUNTS), range(draws)
    ):
        status, reason = "ok", ""
        if failures and (method, count) == FAILED and (source, target) == pairs[1]:
            status, reason = "failed", "LinAlgError: the matrix of patch 17 is singular"
        if failures and (method, count) == UNSUPPORTED:
            status, reason = "unsupported", "needs fewer than 20 examples"
        cell = f"{method}-{source}-{target}-{count}-{draw}"
        usable = status == "ok"
        cells.append(
            {
                "cell": cell, "method": method, "source": source, "target": target, "n_examples": count, "draw": draw,
                **conditions, "status": status, "reason": reason, "prediction": cell,
                "prepare_seconds": 0.2 + 0.1 * rng.random() if method in METHODS else np.nan,
                "fit_seconds": 0.01 * count * (1 + rng.random()) if usable and method in METHODS else np.nan,
                "seconds_per_expression": 0.002 * (1 + rng.random()) if usable and method in METHODS else np.nan,
                "peak_memory_mb": 300 + 50 * rng.random(),
            }
        )  # fmt: skip
        truth = np.stack([neutral[target] + strength[target] * field for field in fields])
        size = np.exp(0.15 * rng.normal(size=len(fields)))[:, None, None] * errors[i] * (1 + noise_mm)
        moved = np.linalg.norm(truth - neutral[target], axis=2, keepdims=True)
        retargeted = truth + size * moved * patterns[method]
        if method == "neutral":
            retargeted = np.broadcast_to(neutral[target], truth.shape)
        distance = np.linalg.norm(retargeted - truth, axis=2)
        for (name, vertices), (t, expression) in itertools.product(regions.items(), enumerate(expressions)):
            for metric, value in (
                ("vertex_l2_mean", distance[t, vertices].mean()),
                ("vertex_l2_max", distance[t, vertices].max()),
            ):
                metric_rows.append(
                    {
                        "method": method, "source": source, "target": target, "n_examples": count, "draw": draw,
                        "expression": expression, "metric": metric, "region": name,
                        "value": float(value) if usable else np.nan, "unit": "mm", **conditions, "status": status,
                    }
                )  # fmt: skip
        if (source, target) == pairs[0] and draw == 0 and usable:
            (folder / cell).mkdir(exist_ok=True)
            np.savez_compressed(
                folder / cell / "frames.npz",
                faces=faces,
                source_neutral=neutral[source].astype(np.float32),
                target_neutral=neutral[target].astype(np.float32),
                source=np.stack([neutral[source] + strength[source] * f for f in fields]).astype(np.float32),
                truth=truth.astype(np.float32),
                retargeted=np.asarray(retargeted, dtype=np.float32),
                expressions=np.array(expressions),
                region_head=head_region,
            )
    metrics = pd.DataFrame(metric_rows, columns=list(METRIC_COLUMNS))
    metrics.to_parquet(folder / "metrics.parquet", index=False)
    pd.DataFrame(cells).to_parquet(folder / "cells.parquet", index=False)
    summarise(metrics, "plbs", FAMILY).to_csv(folder / "summary.csv", index=False)
    facts = {
        "schema": schema,
        "study": "example",
        "title": "Quantitative comparison on synthesised ground truth",
        "description": "All ordered pairs of identities, 5, 15 and 30 target examples, after section 4.4 of the paper.",
        "config": {"dataset": {"noise_mm": noise_mm}, "paths": {"results": str(folder)}},
        "reference": "plbs",
        "primary_family": FAMILY,
        "primary_metric": "vertex_l2_mean",
        "primary_region": "head",
        "methods": [
            {
                "name": name,
                "label": name.replace("_", " "),
                "description": f"What {name} does, in one sentence that is long enough to wrap in its column.",
                "kind": "control" if name.endswith("residual") else "method" if name in METHODS else "reference",
                "settings": {"_target_": f"baselines.{name}.Method", "regularisation": 1e-3, "patch_count": None},
            }
            for name in (*METHODS, *REFERENCES)
        ],
        "n_examples": list(COUNTS),
        "draws": draws,
        "identities": names,
        "expressions": 250,
        "vertices": len(base),
        "faces": len(faces),
        "dataset": {
            "name": "example",
            "truth": "personal_blendshapes",
            "weights": "sparse",
            "noise_mm": noise_mm,
            "favours": "The truth is linear in the blendshapes, which favours linear methods.",
            "fingerprint": "9f2c" * 16,
        },
        "provenance": {
            "project_version": "0.1.0",
            "code_hash": "3ab1" * 16,
            "python": "3.11.7",
            "platform": "Linux x86_64",
            "cores": 2,
            "threads": 1,
            "packages": {"numpy": "2.4.6", "scipy": "1.17.1", "pandas": "3.1.1"},
            "started": "2026-01-02T03:04:05+00:00",
            "finished": "2026-01-02T03:09:11+00:00",
            "wall_seconds": 306.0,
            "seed": 0,
        },
    }
    (folder / "study.json").write_text(json.dumps(facts))
    return folder


def _bumps(base: np.ndarray, rng: np.random.Generator, count: int = 3, height: float = 8.0) -> np.ndarray:
    """A smooth displacement (n, 3) mm of the front of the egg."""
    front = base[base[:, 2] > 0.3 * base[:, 2].max()]
    centres = front[rng.integers(len(front), size=count)]
    near = np.exp(-((np.linalg.norm(base[:, None] - centres, axis=2) / 25.0) ** 2))
    return np.asarray(near @ rng.normal(size=(count, 3)) * height)
