"""A robot's description, walked through before MuJoCo sees it: its parser opens every file that is named in one."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from hybrid_id.errors import InputError
from hybrid_id.reading import LONGEST_NAME, read_bytes, refuse_outside, size_of

LARGEST = 32 * 2**20
"""Bytes of a description, its included files counted in."""
LARGEST_MESH = 200_000_000
MOST_DEPTH = 200
MOST_ELEMENTS = 20_000
"""Elements of a description; those that are repeated count as often as they are."""
MOST_JOINTS = 300
"""Elements that are joints, those of defaults and tendons counted in."""
MOST_PIXELS = 5_000_000
"""Of a texture or a height field that MuJoCo makes by itself, and entries that it may be told to set aside."""
LARGEST_NUMBER = 1e30
NAMES = (
    "name",
    "class",
    "childclass",
    "joint",
    "body",
    "link",
    "parent",
    "child",
    "site",
    "mesh",
    "file",
    "data",
)
"""Attributes that hold names, which may look like numbers."""
ROOTS = ("mujoco", "robot")
REPEATED = ("replicate", "composite", "flexcomp")
AREAS = {"texture": ("width", "height"), "hfield": ("nrow", "ncol")}
DESCRIPTIONS = ("include", "model")
"""Elements whose file is a description, too."""


def walk(path: Path) -> None:
    """See that a description and all files that it names are such as a robot has.

    Raises:
        InputError: it is no XML, declares a document type or entities, is larger, deeper or wider than any robot's,
            includes a file twice or in a circle, or names a file outside its folder, a pipe or a device.
        OSError: it cannot be reached.
    """
    found = _Walk(path)
    found.file(path)
    found.assets()


@dataclass
class _Walk:
    """What has been met so far.

    Attributes:
        main: the description that the user named.
        met: files that were walked through.
        bytes, elements, joints: of all of them.
        strip: whether MuJoCo takes the last part of a file's name only.
        folders: where it looks for textures, and for all else.
        named: element and file of each mesh, texture and the like.
    """

    main: Path
    met: set[Path] = field(default_factory=set)
    bytes: int = 0
    elements: float = 0.0
    joints: float = 0.0
    strip: bool = False
    folders: dict[str, set[str]] = field(default_factory=lambda: {"texture": {""}, "mesh": {""}})
    named: set[tuple[str, str]] = field(default_factory=set)

    def file(self, path: Path) -> None:
        """Walk through one file and those that it includes."""
        self.met.add(path.resolve())
        content = read_bytes(path, LARGEST - self.bytes, "robot's description")
        self.bytes += len(content)
        parser, times, included = expat.ParserCreate("utf-8"), [1.0], list[str]()

        def start(tag: str, values: dict[str, str]) -> None:
            if len(times) == 1 and path == self.main and tag not in ROOTS:
                raise InputError(
                    f"{self.main}: it begins with neither <mujoco> nor <robot>; give an MJCF or URDF file."
                )
            if len(times) > MOST_DEPTH:
                raise InputError(
                    f"{path}: elements are nested deeper than {MOST_DEPTH}; give a robot's description."
                )
            many = math.prod(_numbers(values.get("count", "1"))) if tag in REPEATED else 1.0
            times.append(times[-1] * max(many, 1.0))
            self._element(path, tag, values, times[-1])
            if tag in DESCRIPTIONS and "file" in values:
                included.append(values["file"])

        def declared(*_: object) -> None:
            raise InputError(f"{path}: <!DOCTYPE is not read in a robot's description; take it out.")

        parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, declared
        parser.EndElementHandler = lambda _: times.pop() and None
        try:
            content.decode("utf-8")
            parser.Parse(content, True)
        except UnicodeDecodeError:
            raise InputError(
                f"{path}: cannot be read (it is no text in UTF-8); give an MJCF or URDF file."
            ) from None
        except expat.ExpatError as error:
            raise InputError(
                f"{path}, row {error.lineno}: no XML ({expat.ErrorString(error.code)}); give an MJCF or URDF file."
            ) from None
        for name in included:
            # walk through an included file, wherever MuJoCo may look for it
            places = {folder / name for folder in (self.main.parent, path.parent)}
            for place in places:
                self._inside(place, f"{path}: <include> of {name}")
            for place in sorted(place for place in places if place.exists()):
                if place.resolve() in self.met:
                    raise InputError(f"{path}: {name} is included twice or in a circle; include it once.")
                self.file(place)

    def _element(self, path: Path, tag: str, values: dict[str, str], times: float) -> None:
        """Count an element, and keep what it says of files."""
        self.elements += times
        self.joints += times if tag.endswith("joint") else 0.0
        if (
            self.elements > MOST_ELEMENTS or self.joints > 2 * MOST_JOINTS
        ):  # actuators and sensors name joints, too
            raise InputError(
                f"{path}: more than {MOST_ELEMENTS} elements or {MOST_JOINTS} joints, which no arm has; leave out what "
                "is not needed."
            )
        if len(values.get("name", "")) > LONGEST_NAME:
            raise InputError(f"{path}: the name of a <{tag}> has more than {LONGEST_NAME} signs; shorten it.")
        for key, words in values.items():
            if key not in NAMES and (odd := _senseless(key, words)):
                name = f" '{values['name']}'" if values.get("name") else ""
                raise InputError(
                    f"{path}: '{key}' of <{tag}>{name} is {odd}, which no machine has; correct it."
                )
        reserved = [n for key, words in values.items() if key != "memory" for n in _numbers(words)]
        area = math.prod(n for key in AREAS.get(tag, ()) for n in _numbers(values.get(key, "")))
        if area > MOST_PIXELS or (tag == "size" and max(reserved, default=0.0) > MOST_PIXELS):
            raise InputError(
                f"{path}: <{tag}> asks for more than {MOST_PIXELS} entries; no arm needs that many."
            )
        if tag == "compiler":
            self.strip = {"true": True, "false": False}.get(values.get("strippath", ""), self.strip)
            for kind, key in (("texture", "texturedir"), ("mesh", "meshdir")):
                self.folders[kind] |= {values[k] for k in (key, "assetdir") if k in values}
        if tag not in DESCRIPTIONS:
            self.named |= {(tag, name) for key, name in values.items() if key.startswith("file")}

    def assets(self) -> None:
        """See that every mesh, texture and the like that is there lies below the description, and is a file."""
        for tag, name in sorted(self.named):
            own = name.replace("\\", "/")
            own = own.rsplit("/", 1)[-1] if self.strip else own
            for folder in self.folders["texture" if tag == "texture" else "mesh"]:
                # MuJoCo steps back by the name alone, whether the folders in it are there or not
                place = self.main.parent / os.path.normpath(Path(folder, own))
                try:
                    if not os.path.lexists(place):
                        continue
                except ValueError:  # no file can have that name
                    continue
                self._inside(place, f"{self.main}: the file {name} of a <{tag}>")
                if not place.is_dir() and size_of(place) > LARGEST_MESH:
                    raise InputError(
                        f"{place} is larger than {LARGEST_MESH / 1e6:g} MB; give a simpler <{tag}>."
                    )

    def _inside(self, place: Path, what: str) -> None:
        refuse_outside(place, self.main.parent, what, "bring it there, or take it out")


def _senseless(key: str, words: str) -> str:
    """The first word of an attribute that is no number of a machine; limits may be infinite, so that they are none."""
    limit = key.endswith("range") or key in ("effort", "velocity", "lower", "upper")
    for word, number in _read(words):
        if math.isnan(number) or (abs(number) > LARGEST_NUMBER and not limit):
            return word
    return ""


def _numbers(words: str) -> list[float]:
    """Numbers in an attribute, but for what is none."""
    return [number for _, number in _read(words) if not math.isnan(number)]


def _read(words: str) -> Iterator[tuple[str, float]]:
    """The first words of an attribute that are numbers, NaN too, and those."""
    for word in words.split()[:99]:
        with suppress(ValueError):
            yield word, float(word)
