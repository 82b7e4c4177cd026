"""A coloured cloud or triangle mesh as a binary .ply file.

Open3D's own writer says that all went well where the disk is full, and leaves a part of the file.
"""

import numpy as np

FIELDS = {
    "vertices": (("x", "y", "z"), "<f4", "float"),
    "normals": (("nx", "ny", "nz"), "<f4", "float"),
    "colors": (("red", "green", "blue"), "u1", "uchar"),
}
TRIANGLE = np.dtype([("count", "u1"), ("indices", "<u4", 3)])


def ply_bytes(
    vertices: np.ndarray, colors: np.ndarray, normals: np.ndarray | None = None, triangles: np.ndarray | None = None
) -> bytes:
    """The file's content.

    Parameters
    ----------
    vertices : (N, 3) float, kept as float32.    colors : (N, 3), 0..1, kept as 8 bits.    normals : (N, 3), unit.
    triangles : (K, 3) indices.
    """
    given = {"vertices": vertices, "normals": normals, "colors": np.floor(255.0 * np.clip(colors, 0.0, 1.0) + 0.5)}
    given = {name: values for name, values in given.items() if values is not None}
    rows = np.empty(len(vertices), [(name, FIELDS[name][1], 3) for name in given])
    header = ["ply", "format binary_little_endian 1.0", "comment adagmm-fusion", f"element vertex {len(vertices)}"]
    for name, values in given.items():
        rows[name] = values
        header += [f"property {FIELDS[name][2]} {axis}" for axis in FIELDS[name][0]]
    faces = np.empty(0 if triangles is None else len(triangles), TRIANGLE)
    if triangles is not None:
        faces["count"], faces["indices"] = 3, triangles
        header += [f"element face {len(triangles)}", "property list uchar uint vertex_indices"]
    return "\n".join([*header, "end_header\n"]).encode() + rows.tobytes() + faces.tobytes()
