"""What a kept result depends on besides its input: the program that made it."""

import hashlib
import importlib.util
from functools import cache
from pathlib import Path

from adagmm_fusion.package_versions import package_version


@cache
def source_digest(*modules: str, distributions: tuple[str, ...] = ()) -> str:
    """Twelve digits that change with any Python file of these packages and modules, and with the versions of these
    distributions."""
    digest = hashlib.sha256()
    for name in modules:
        spec = importlib.util.find_spec(name)
        assert spec is not None and spec.origin is not None, name
        origin = Path(spec.origin)
        folder = origin.parent
        paths = sorted(folder.rglob("*.py")) if origin.name == "__init__.py" else [origin]
        for path in paths:
            digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    for name in distributions:
        digest.update(f"{name} {package_version(name)}".encode())
    return digest.hexdigest()[:12]
