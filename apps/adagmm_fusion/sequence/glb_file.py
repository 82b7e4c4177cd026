"""A coloured triangle mesh as a binary glTF 2.0 file, which browsers, Blender and Windows show.

Open3D's own .glb files keep their data as base64 text and are not read by Assimp, nor by Open3D itself.
"""

import json
import struct

import numpy as np

FLOAT32, UINT8, UINT32 = 5126, 5121, 5125
VERTEX_DATA, INDEX_DATA = 34962, 34963
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"
# Half a turn about x: from x right, y down, z forward to glTF's x right, y up, z backward.
TURN = [1.0, 0.0, 0.0, 0.0]


def glb_bytes(vertices: np.ndarray, normals: np.ndarray, colors: np.ndarray, triangles: np.ndarray) -> bytes:
    """The file's content.

    Parameters
    ----------
    vertices : (N, 3) float, metres, camera frame (x right, y down, z forward).    normals : (N, 3), unit.
    colors : (N, 3) sRGB, 0..1.    triangles : (K, 3) indices.
    """
    positions = np.ascontiguousarray(vertices, dtype="<f4")
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)  # as glTF wants them
    rgba = np.concatenate((linear, np.ones((len(colors), 1))), axis=1)
    rgba = np.floor(255.0 * rgba + 0.5).astype(np.uint8)
    parts = (
        (positions, FLOAT32, "VEC3", VERTEX_DATA),
        (np.ascontiguousarray(normals, dtype="<f4"), FLOAT32, "VEC3", VERTEX_DATA),
        (rgba, UINT8, "VEC4", VERTEX_DATA),
        (np.ascontiguousarray(triangles, dtype="<u4").reshape(-1), UINT32, "SCALAR", INDEX_DATA),
    )
    views, accessors, offset = [], [], 0
    for i, (array, kind, shape, target) in enumerate(parts):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": target})
        accessors.append({"bufferView": i, "componentType": kind, "count": len(array), "type": shape})
        offset += array.nbytes  # all multiples of four bytes
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    accessors[2]["normalized"] = True
    scene = {
        "asset": {"version": "2.0", "generator": "adagmm-fusion"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": TURN}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0}]}
        ],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}, "doubleSided": True}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(array.tobytes() for array, *_ in parts)
    chunks = struct.pack("<I4s", len(text), JSON_CHUNK) + text + struct.pack("<I4s", len(binary), BINARY_CHUNK) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
