"""What the colours of the layers mean: the colours themselves, and a legend with numbers for each."""

import numpy as np
import rerun as rr

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.clouds import OVERLAP, RESIDUAL_MM, WEIGHT_SHARE
from adagmm_fusion.rerun_log.diagnostics import CONTRADICTED, HIDDEN, PARTNER, PointDiagnostics
from adagmm_fusion.rerun_log.when import When

NO_PARTNER_COLOR = (70, 74, 84)
WEIGHT_RAMP = np.array(((38, 30, 70), (120, 40, 130), (220, 80, 90), (255, 180, 80), (255, 250, 180)))
RESIDUAL_RAMP = np.array(((30, 150, 90), (150, 200, 70), (250, 220, 80), (240, 130, 50), (215, 40, 40)))
OVERLAP_COLORS = {PARTNER: (60, 190, 110), HIDDEN: NO_PARTNER_COLOR, CONTRADICTED: (225, 50, 60)}
OVERLAP_NAMES = {PARTNER: "partner", HIDDEN: "out of sight", CONTRADICTED: "contradicted"}
MOST_WEIGHT_SHOWN = 2.0
RESIDUAL_SHARE_OF_PARTNER_DISTANCE = 0.5
STRIP = (12, 240)
HISTOGRAM_BARS = 30


def ramp_colors(values: np.ndarray, largest: float, ramp: np.ndarray) -> np.ndarray:
    """(N, 3) uint8: 0 is the ramp's first colour, `largest` and more its last, NaN the colour of no partner."""
    position = np.clip(np.nan_to_num(values) / largest, 0.0, 1.0) * (len(ramp) - 1)
    colors = np.stack([np.interp(position, np.arange(len(ramp)), ramp[:, c]) for c in range(3)], axis=-1)
    colors[np.isnan(values)] = NO_PARTNER_COLOR
    return colors.astype(np.uint8)


def largest_residual_mm(diagnostics: PointDiagnostics) -> float:
    """The end of the residual scale: half the distance at which a point stops being a partner."""
    return float(np.ceil(1000.0 * RESIDUAL_SHARE_OF_PARTNER_DISTANCE * diagnostics.partner_distance))


def overlap_colors(overlap: np.ndarray) -> np.ndarray:
    """(M, 3) uint8."""
    table = np.zeros((len(OVERLAP_COLORS), 3), dtype=np.uint8)
    for state, color in OVERLAP_COLORS.items():
        table[state] = color
    return table[overlap]


def why_layers(diagnostics: PointDiagnostics | None, n: int) -> dict[str, np.ndarray]:
    """The source's colours that say why, by layer, (n, 3) uint8 each; without diagnostics no point has a partner."""
    if diagnostics is None:
        return {
            layer: np.tile(np.asarray(NO_PARTNER_COLOR, np.uint8), (n, 1))
            for layer in (WEIGHT_SHARE, RESIDUAL_MM, OVERLAP)
        }
    return {
        WEIGHT_SHARE: ramp_colors(diagnostics.weight_share, MOST_WEIGHT_SHOWN, WEIGHT_RAMP),
        RESIDUAL_MM: ramp_colors(diagnostics.residual_mm, largest_residual_mm(diagnostics), RESIDUAL_RAMP),
        OVERLAP: overlap_colors(diagnostics.overlap),
    }


def log_residual_histogram(rec: rr.RecordingStream, diagnostics: PointDiagnostics, when: When) -> None:
    """How many source points are how many millimetres off, as bars; the last bar holds what is farther."""
    largest = largest_residual_mm(diagnostics)
    edges = np.linspace(0.0, largest, HISTOGRAM_BARS + 1)
    known = diagnostics.residual_mm[np.isfinite(diagnostics.residual_mm)]
    counts, _ = np.histogram(np.minimum(known, largest), edges)
    bars = rr.BarChart(counts, abscissa=edges[:-1], widths=np.diff(edges), color=RESIDUAL_RAMP[1])
    when.log(rec, entities.RESIDUAL_HISTOGRAM, bars)


def log_legends(rec: rr.RecordingStream, diagnostics: PointDiagnostics, when: When) -> None:
    """Log the three legends, each a strip of colours with labels, for narrow 2D views."""
    largest = largest_residual_mm(diagnostics)
    _log_strip(rec, entities.WEIGHT_LEGEND, WEIGHT_RAMP, ["0 ignored", "1 average", f"≥ {MOST_WEIGHT_SHOWN:g}"], when)
    _log_strip(rec, entities.RESIDUAL_LEGEND, RESIDUAL_RAMP, ["0", f"{largest / 2:g}", f"≥ {largest:g} mm"], when)
    states = list(OVERLAP_COLORS)
    blocks = np.array([OVERLAP_COLORS[s] for s in states]).repeat(STRIP[1] // len(states), axis=0)
    counts = [f"{OVERLAP_NAMES[s]} {np.mean(diagnostics.overlap == s):.0%}" for s in states]
    _log_labelled(rec, entities.OVERLAP_LEGEND, blocks, counts, (np.arange(3) + 0.5) * STRIP[1] / 3, when)


def _log_strip(rec: rr.RecordingStream, entity: str, ramp: np.ndarray, labels: list[str], when: When) -> None:
    colors = ramp_colors(np.linspace(0.0, 1.0, STRIP[1]), 1.0, ramp)
    _log_labelled(rec, entity, colors, labels, np.linspace(0, STRIP[1], len(labels)), when)


def _log_labelled(
    rec: rr.RecordingStream, entity: str, colors: np.ndarray, labels: list[str], at: np.ndarray, when: When
) -> None:
    image = np.ascontiguousarray(np.broadcast_to(colors[None].astype(np.uint8), (STRIP[0], *colors.shape)))
    when.log(rec, f"{entity}/strip", rr.Image(image))
    positions = np.stack([at, np.full(len(at), STRIP[0] + 6.0)], axis=1)
    ticks = rr.Points2D(positions, labels=labels, radii=0.0, colors=(230, 230, 230), show_labels=True)
    when.log(rec, f"{entity}/labels", ticks)
