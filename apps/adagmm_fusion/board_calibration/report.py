"""Tables of what a calibration found and how well it fits."""

import numpy as np
from rich.table import Table
from rich.text import Text

from adagmm_fusion.board_calibration.rig_calibration import Link, RigCalibration
from adagmm_fusion.board_calibration.sensor import SensorResult
from adagmm_fusion.board_calibration.views import SensorViews
from adagmm_fusion.processes.terminal import printable
from adagmm_o3d.evaluation import pose_errors


def calibration_tables(result: RigCalibration, views: dict[str, SensorViews]) -> tuple[Table, Table]:
    """The sensors, a column each; the reprojection errors [px], a row for each view."""
    return _sensor_table(result), _view_table(result, views)


def _sensor_table(result: RigCalibration) -> Table:
    table = Table()
    for heading in ("sensor", *result.sensors):
        table.add_column(Text(heading))
    links = {link.sensor: link for link in result.links}
    rows: dict[str, list[str]] = {}
    for key, sensor in result.sensors.items():
        k, (dfx, dfy, dcx, dcy) = sensor.intrinsics, sensor.uncertainty_px
        link = links.get(key)
        where = "the rig's frame"
        if link is not None:
            apart = pose_errors(np.eye(4), link.T_reference_sensor)
            where = f"{apart.rotation_deg:.2f}°, {1000.0 * apart.translation:.1f} mm from {link.reference}"
        depth = "no depth images"
        if sensor.depth_units_per_metre is not None:
            depth = f"{sensor.depth_units_per_metre:.5g} ± {sensor.depth_spread:.2g} per metre of the board"
        for label, text in (
            ("image size", f"{k.width} x {k.height}"),
            ("fx, fy", f"{k.fx:.2f} ± {dfx:.2f}, {k.fy:.2f} ± {dfy:.2f} px"),
            ("cx, cy", f"{k.cx:.2f} ± {dcx:.2f}, {k.cy:.2f} ± {dcy:.2f} px"),
            ("distortion", ", ".join(f"{c:.4f}" for c in k.distortion) or "none"),
            ("reprojection error", f"{sensor.rms_px:.3f} px in {len(sensor.errors_px)} views"),
            ("pose", where),
            ("error as a rig", f"{link.rms_px:.3f} px in {len(link.errors_px)} views" if link else ""),
            ("depth", depth),
        ):
            rows.setdefault(label, []).append(text)
    for label, texts in rows.items():
        table.add_row(label, *map(Text, texts))
    return table


def _view_table(result: RigCalibration, views: dict[str, SensorViews]) -> Table:
    table = Table(title=Text("reprojection error [px]"))  # not str: rich would take the unit for markup
    table.add_column("view")
    for heading in [*result.sensors, *(f"{link.sensor} with {link.reference}" for link in result.links)]:
        table.add_column(Text(heading), justify="right")
    names = sorted({view for found in views.values() for view in (*found.corners, *found.without_board)})
    parts: list[SensorResult | Link] = [*result.sensors.values(), *result.links]
    for view in names:
        cells = []
        for part in parts:
            if view in part.errors_px:
                cells.append(Text(f"{part.errors_px[view]:.3f}"))
            elif view in part.outliers_px:
                cells.append(Text(f"{part.outliers_px[view]:.3f}, outlier, left out", style="red"))
            else:
                cells.append(Text("no board" if part in result.sensors.values() else "", style="dim"))
        table.add_row(Text(printable(view)), *cells)
    return table
