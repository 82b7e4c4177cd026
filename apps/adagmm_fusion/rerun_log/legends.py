"""What the colours of the layers mean: the colours themselves, and a legend with numbers for each."""

import cv2
import numpy as np
import rerun as rr

from adagmm_fusion.pairs.point_diagnostics import CONTRADICTED, HIDDEN, PARTNER, PointDiagnostics
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.clouds import COLOR_SUPPORT, OVERLAP, RESIDUAL_MM, WEIGHT_SHARE
from adagmm_fusion.rerun_log.colors import BACKGROUND
from adagmm_fusion.rerun_log.when import When

NO_PARTNER_COLOR = (70, 74, 84)
WEIGHT_RAMP = np.array(((38, 30, 70), (120, 40, 130), (220, 80, 90), (255, 180, 80), (255, 250, 180)))
RESIDUAL_RAMP = np.array(((30, 150, 90), (150, 200, 70), (250, 220, 80), (240, 130, 50), (215, 40, 40)))
OVERLAP_COLORS = {PARTNER: (60, 190, 110), HIDDEN: NO_PARTNER_COLOR, CONTRADICTED: (225, 50, 60)}
OVERLAP_NAMES = {PARTNER: "partner", HIDDEN: "out of sight", CONTRADICTED: "contradicted"}
COLOR_RAMP = np.array(((225, 50, 60), (200, 150, 130), (210, 210, 200), (120, 190, 150), (60, 190, 110)))
MOST_WEIGHT_SHOWN = 2.0
MOST_SUPPORT_SHOWN = 2.0  # nats, for and against
RESIDUAL_SHARE_OF_PARTNER_DISTANCE = 0.5
# A legend is an image with its labels in it: text that the viewer draws itself has colours that its themes decide on.
LEGEND_SIZE = (72, 840)
STRIP = slice(6, 30)
STRIP_COLUMNS = slice(60, 780)
LABEL_ROW, LABEL_SCALE, LABEL_COLOR = 60, 0.8, (235, 235, 235)
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


def support_colors(support: np.ndarray | None, n: int) -> np.ndarray:
    """(n, 3) uint8: red where the colours speak against a point's partners, green where for them, grey without any."""
    values = np.full(n, np.nan) if support is None else np.asarray(support, dtype=np.float64)
    return ramp_colors(np.maximum(values + MOST_SUPPORT_SHOWN, 0.0), 2.0 * MOST_SUPPORT_SHOWN, COLOR_RAMP)


def why_layers(diagnostics: PointDiagnostics | None, n: int) -> dict[str, np.ndarray]:
    """The source's colours that say why, by layer, (n, 3) uint8 each; without diagnostics no point has a partner."""
    if diagnostics is None:
        return {
            layer: np.tile(np.asarray(NO_PARTNER_COLOR, np.uint8), (n, 1))
            for layer in (WEIGHT_SHARE, RESIDUAL_MM, OVERLAP, COLOR_SUPPORT)
        }
    return {
        WEIGHT_SHARE: ramp_colors(diagnostics.weight_share, MOST_WEIGHT_SHOWN, WEIGHT_RAMP),
        RESIDUAL_MM: ramp_colors(diagnostics.residual_mm, largest_residual_mm(diagnostics), RESIDUAL_RAMP),
        OVERLAP: overlap_colors(diagnostics.overlap),
        COLOR_SUPPORT: support_colors(diagnostics.color_support, n),
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
    weights = legend(WEIGHT_RAMP, ["0 ignored", "1 average", f"{MOST_WEIGHT_SHOWN:g} and more"])
    residuals = legend(RESIDUAL_RAMP, ["0", f"{largest / 2:g}", f"{largest:g} mm and more"])
    states = list(OVERLAP_COLORS)
    shares = [f"{OVERLAP_NAMES[s]} {np.mean(diagnostics.overlap == s):.0%}" for s in states]
    partners = legend(np.array([OVERLAP_COLORS[s] for s in states]), shares, blocks=True)
    colors = legend(COLOR_RAMP, ["against", "nothing", "for"])
    for entity, image in (
        (entities.WEIGHT_LEGEND, weights),
        (entities.RESIDUAL_LEGEND, residuals),
        (entities.OVERLAP_LEGEND, partners),
        (entities.COLOR_LEGEND, colors),
    ):
        when.log(rec, entity, rr.Image(image))


def legend(colors: np.ndarray, labels: list[str], *, blocks: bool = False) -> np.ndarray:
    """(H, W, 3) uint8: colours (n, 3) as a ramp or as blocks side by side, with labels below, evenly spread."""
    image = np.full((*LEGEND_SIZE, 3), BACKGROUND, np.uint8)
    width = STRIP_COLUMNS.stop - STRIP_COLUMNS.start
    at = np.linspace(0.0, 1.0, width)
    shown = (
        colors[np.minimum((at * len(colors)).astype(int), len(colors) - 1)] if blocks else ramp_colors(at, 1.0, colors)
    )
    image[STRIP, STRIP_COLUMNS] = shown
    for i, label in enumerate(labels):
        text_width = cv2.getTextSize(label, cv2.FONT_HERSHEY_SIMPLEX, LABEL_SCALE, 1)[0][0]
        middle = STRIP_COLUMNS.start + width * ((i + 0.5) / len(labels) if blocks else i / (len(labels) - 1))
        left = int(np.clip(middle - text_width / 2, 2, LEGEND_SIZE[1] - text_width - 2))
        place = (left, LABEL_ROW)
        cv2.putText(image, label, place, cv2.FONT_HERSHEY_SIMPLEX, LABEL_SCALE, LABEL_COLOR, 1, cv2.LINE_AA)
    return image
