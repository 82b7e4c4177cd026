"""The paper's figures: error against a factor, one line a method; errors of all methods on one pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from adagmm_fusion.files.atomic_file import replacing

# Okabe and Ito's colours, told apart by colour-blind readers too; ours is always the first, thick and black.
COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#0072B2", "#CC79A7", "#8C8C8C")
MARKERS = ("o", "s", "^", "v", "D", "P", "X", "*")
MAX_LINES = len(COLOURS)
# A line whose median is below this share of the highest mean lies on zero for the eye.
ON_ZERO = 0.05
# On a logarithmic axis: where errors of zero are put, and how far below its mean a bar ends at most.
LEAST_SHOWN, LEAST_OF_MEAN = 1e-4, 0.1
ERROR_LABEL = r"rotation error $\|I - R_{gt} R^{-1}\|_F$"
AXES = {
    "rotation": ("initial rotation [deg]", 1.0),
    "noise": ("noise standard deviation [RMS radii]", 1.0),
    "outliers": ("outliers [% of the model's points]", 100.0),
    "occlusion": ("occlusion [%]", 100.0),
}


def plot_sweep(path: Path, title: str, sweep: str, lines: Mapping[str, Mapping[float, tuple[float, float]]]) -> None:
    """Mean rotation error with its standard deviation per setting; `lines` maps labels to setting -> (mean, std).

    Lines stand a little beside each other so that their bars can be told apart. The axis is logarithmic where the first
    one, ours, would lie on zero on another.
    """
    label, factor = AXES[sweep]
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    settings = sorted({setting for line in lines.values() for setting in line})
    step = factor * float(np.min(np.diff(settings))) if len(settings) > 1 else 1.0
    highest = 0.0
    ours = np.array(list(next(iter(lines.values())).values()))[:, 0]
    most = max(mean for line in lines.values() for mean, _ in line.values())
    logarithmic = bool(np.median(ours) < ON_ZERO * most)
    for i, (name, line) in enumerate(lines.items()):
        x = factor * np.array(list(line)) + step * 0.07 * (i - (len(lines) - 1) / 2)
        mean, std = np.array(list(line.values())).T
        highest = max(highest, float((mean + std).max()))
        axes.errorbar(
            x,
            np.maximum(mean, LEAST_SHOWN) if logarithmic else mean,
            # Errors are not negative: the bar ends at zero, which a logarithmic axis does not have.
            yerr=[np.minimum(std, (1.0 - LEAST_OF_MEAN if logarithmic else 1.0) * mean), std],
            label=name,
            color=COLOURS[i % MAX_LINES],
            marker=MARKERS[i % MAX_LINES],
            markersize=4.5,
            linewidth=2.4 if i == 0 else 1.3,
            elinewidth=0.8,
            capsize=2,
            zorder=10 - i,
        )
    axes.set_xlabel(label)
    axes.set_ylabel(ERROR_LABEL)
    if logarithmic:
        axes.set_yscale("log")
    else:
        axes.set_ylim(0.0, max(1.05 * highest, 0.02))
    axes.set_title(title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=2, framealpha=0.85)
    _save(figure, path)


def plot_pair_errors(
    path: Path,
    title: str,
    labels: Sequence[str],
    errors: Sequence[float],
    *,
    ours: Sequence[str],
    published: float | None,
) -> None:
    """Figure 18: the rotation error of every method on one pair as dots, best on top."""
    figure = Figure(figsize=(8.0, 1.2 + 0.28 * len(labels)), layout="constrained")
    axes = figure.add_subplot()
    order = np.argsort(errors, kind="stable")[::-1]
    colours = ["#000000" if labels[i] in ours else "#56B4E9" for i in order]
    rows = np.arange(len(order))
    axes.scatter([errors[i] for i in order], rows, color=colours, zorder=3)
    axes.grid(alpha=0.3)
    axes.set_yticks(rows, [labels[i] for i in order], fontsize=8)
    for row, i in zip(rows, order, strict=True):
        axes.text(errors[i], row, f"  {errors[i]:.4f}", va="center", fontsize=7)
    if published is not None:
        axes.axvline(published, color="#D55E00", linestyle="--", linewidth=1.2, label=f"the paper's {published:g}")
        figure.legend(fontsize=8, loc="outside lower right")
    axes.set_xscale("log")
    axes.margins(x=0.12, y=0.01)
    axes.set_xlabel(ERROR_LABEL)
    axes.set_title(title)
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    """Write the figure as it is named, and as .svg beside it; the same figure is the same bytes."""
    for beside in (path, path.with_suffix(".svg")):
        undated = {"Date": None} if beside.suffix == ".svg" else {}
        with replacing(beside) as temporary, rc_context({"svg.hashsalt": "adagmm"}):
            figure.savefig(temporary, dpi=130, format=beside.suffix[1:], metadata=undated)
