"""The 52 face units of ARKit (`ARFaceAnchor.BlendShapeLocation`), by name.

Meshes name them in camelCase (``jawOpen``), Live Link Face's CSV in PascalCase (``JawOpen``) and in an order of
its own: always map by name. Left and right are the character's own.
"""

from __future__ import annotations

_SIDED = (
    "eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide", "jaw", "mouth",
    "mouthSmile", "mouthFrown", "mouthDimple", "mouthStretch", "mouthPress", "mouthLowerDown", "mouthUpperUp",
    "browDown", "browOuterUp", "cheekSquint", "noseSneer",
)  # fmt: skip
_MIDDLE = (
    "jawForward", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRollLower", "mouthRollUpper",
    "mouthShrugLower", "mouthShrugUpper", "browInnerUp", "cheekPuff", "tongueOut",
)  # fmt: skip

NAMES: tuple[str, ...] = tuple(sorted([*_MIDDLE, *(name + side for name in _SIDED for side in ("Left", "Right"))]))
SKIN_NAMES: tuple[str, ...] = tuple(name for name in NAMES if name != "tongueOut")  # the tongue moves no skin
LIVE_LINK: dict[str, str] = {name: name[0].upper() + name[1:] for name in NAMES}
MIRRORED: dict[str, str] = {
    name: name.replace("Left", "Right") if "Left" in name else name.replace("Right", "Left") for name in NAMES
}
