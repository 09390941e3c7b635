"""Write the .meta files of the Unity package: an identity for each asset, which Unity would otherwise make up anew.

    python3 peers/csharp/make_meta.py

Unity ignores assets of an installed package that have none.
"""

import hashlib
from pathlib import Path

PACKAGE = Path(__file__).parent / "Hapticnet"


def metas() -> dict[Path, str]:
    """Return the path and the text of each .meta file."""
    found = {}
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix != ".meta":
            name = path.relative_to(PACKAGE).as_posix()
            guid = hashlib.md5(f"com.hapticnet.hapticnet/{name}".encode(), usedforsecurity=False).hexdigest()
            folder = "folderAsset: yes\n" if path.is_dir() else ""
            found[path.with_name(f"{path.name}.meta")] = f"fileFormatVersion: 2\nguid: {guid}\n{folder}"
    return found


if __name__ == "__main__":
    for old in PACKAGE.rglob("*.meta"):
        old.unlink()
    for path, text in metas().items():
        path.write_text(text, encoding="utf-8")
