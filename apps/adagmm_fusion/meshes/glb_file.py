"""Triangle meshes as binary glTF 2.0 files, which browsers, Blender and Windows show.

Open3D's own .glb files keep their data as base64 text and are not read by Assimp, nor by Open3D itself.
"""

import json
import struct

import cv2
import numpy as np

FLOAT32, UINT8, UINT32 = 5126, 5121, 5125
VERTEX_DATA, INDEX_DATA = 34962, 34963
JSON_CHUNK, BINARY_CHUNK = b"JSON", b"BIN\0"
LINEAR, CLAMP_TO_EDGE = 9729, 33071
# Half a turn about x: from x right, y down, z forward to glTF's x right, y up, z backward.
TURN = [1.0, 0.0, 0.0, 0.0]
MATTE = {"metallicFactor": 0.0, "roughnessFactor": 1.0}


def colored_glb(vertices: np.ndarray, normals: np.ndarray, colors: np.ndarray, triangles: np.ndarray) -> bytes:
    """The file of a mesh with a colour at each vertex.

    Parameters
    ----------
    vertices : (N, 3) float, metres, camera frame (x right, y down, z forward).    normals : (N, 3), unit.
    colors : (N, 3) sRGB, 0..1.    triangles : (K, 3) indices.
    """
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)  # as glTF wants them
    rgba = np.concatenate((linear, np.ones((len(colors), 1))), axis=1)
    rgba = np.floor(255.0 * rgba + 0.5).astype(np.uint8)
    scene = {"materials": [{"pbrMetallicRoughness": MATTE, "doubleSided": True}]}
    return _glb(vertices, normals, triangles, {"COLOR_0": (rgba, UINT8, "VEC4")}, scene)


def textured_glb(
    vertices: np.ndarray, normals: np.ndarray, uvs: np.ndarray, triangles: np.ndarray, texture: np.ndarray
) -> bytes:
    """The file of a mesh with a texture, shown as it is, unlit: light and shadow are in the photographs.

    Parameters
    ----------
    vertices, normals, triangles : as colored_glb.    uvs : (N, 2) in 0..1 from the texture's top left corner.
    texture : (H, W, 3) uint8 sRGB.
    """
    png = cv2.imencode(".png", np.ascontiguousarray(texture[:, :, ::-1]))[1].tobytes()
    scene = {
        "extensionsUsed": ["KHR_materials_unlit"],
        "materials": [
            {
                "pbrMetallicRoughness": MATTE | {"baseColorTexture": {"index": 0}},
                "doubleSided": True,
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": LINEAR, "minFilter": LINEAR, "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE}],
    }
    coordinates = np.ascontiguousarray(uvs, dtype="<f4")
    return _glb(vertices, normals, triangles, {"TEXCOORD_0": (coordinates, FLOAT32, "VEC2")}, scene, png)


def _glb(
    vertices: np.ndarray,
    normals: np.ndarray,
    triangles: np.ndarray,
    attributes: dict,
    scene: dict,
    png: bytes | None = None,
) -> bytes:
    positions = np.ascontiguousarray(vertices, dtype="<f4")
    parts = {
        "POSITION": (positions, FLOAT32, "VEC3"),
        "NORMAL": (np.ascontiguousarray(normals, dtype="<f4"), FLOAT32, "VEC3"),
        **attributes,
        "indices": (np.ascontiguousarray(triangles, dtype="<u4").reshape(-1), UINT32, "SCALAR"),
    }
    views, accessors, offset = [], [], 0
    for i, (name, (array, kind, shape)) in enumerate(parts.items()):
        target = INDEX_DATA if name == "indices" else VERTEX_DATA
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": target})
        accessors.append({"bufferView": i, "componentType": kind, "count": len(array), "type": shape})
        if kind == UINT8:
            accessors[-1]["normalized"] = True
        offset += array.nbytes  # all multiples of four bytes
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    binary = b"".join(array.tobytes() for array, *_ in parts.values())
    images = {}
    if png is not None:
        images = {"images": [{"bufferView": len(views), "mimeType": "image/png"}]}
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(png)})
        binary += png + b"\0" * (-len(png) % 4)
    numbers = {name: i for i, name in enumerate(parts)}
    indices = numbers.pop("indices")
    description = {
        "asset": {"version": "2.0", "generator": "adagmm-fusion"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "rotation": TURN}],
        "meshes": [{"primitives": [{"attributes": numbers, "indices": indices, "material": 0}]}],
        **scene,
        **images,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(description).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), JSON_CHUNK) + text + struct.pack("<I4s", len(binary), BINARY_CHUNK) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
