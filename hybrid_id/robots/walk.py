"""A robot's description, walked through before MuJoCo sees it: its parser opens every file that is named in one."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import suppress
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
    met: set[Path] = set()  # files that were walked through
    size, elements, joints = 0, 0.0, 0.0  # of all of them
    strip = False  # whether MuJoCo takes the last part of a file's name only
    folders: dict[str, set[str]] = {
        "texture": {""},
        "mesh": {""},
    }  # where it looks for textures, and for all else
    named: set[tuple[str, str]] = set()  # element and file of each mesh, texture and the like

    def inside(place: Path, what: str) -> None:
        refuse_outside(place, path.parent, what, "bring it there, or take it out")

    def enter(file: Path) -> None:
        """Walk through one file and those that it includes."""
        nonlocal size
        met.add(file.resolve())
        content = read_bytes(file, LARGEST - size, "robot's description")
        size += len(content)
        parser, times, included = expat.ParserCreate("utf-8"), [1.0], list[str]()

        def start(tag: str, values: dict[str, str]) -> None:
            """Count an element, and keep what it says of files."""
            nonlocal elements, joints, strip
            if len(times) == 1 and file == path and tag not in ROOTS:
                raise InputError(
                    f"{path}: it begins with neither <mujoco> nor <robot>; give an MJCF or URDF file."
                )
            if len(times) > MOST_DEPTH:
                raise InputError(
                    f"{file}: elements are nested deeper than {MOST_DEPTH}; give a robot's description."
                )
            many = math.prod(_numbers(values.get("count", "1"))) if tag in REPEATED else 1.0
            times.append(times[-1] * max(many, 1.0))
            elements += times[-1]
            joints += times[-1] if tag.endswith("joint") else 0.0
            if elements > MOST_ELEMENTS or joints > 2 * MOST_JOINTS:  # actuators and sensors name joints, too
                raise InputError(
                    f"{file}: more than {MOST_ELEMENTS} elements or {MOST_JOINTS} joints, which no arm has; leave out "
                    "what is not needed."
                )
            if len(values.get("name", "")) > LONGEST_NAME:
                raise InputError(
                    f"{file}: the name of a <{tag}> has more than {LONGEST_NAME} signs; shorten it."
                )
            for key, words in values.items():
                if key not in NAMES and (odd := _senseless(key, words)):
                    name = f" '{values['name']}'" if values.get("name") else ""
                    raise InputError(
                        f"{file}: '{key}' of <{tag}>{name} is {odd}, which no machine has; correct it."
                    )
            reserved = [n for key, words in values.items() if key != "memory" for n in _numbers(words)]
            area = math.prod(n for key in AREAS.get(tag, ()) for n in _numbers(values.get(key, "")))
            if area > MOST_PIXELS or (tag == "size" and max(reserved, default=0.0) > MOST_PIXELS):
                raise InputError(
                    f"{file}: <{tag}> asks for more than {MOST_PIXELS} entries; no arm needs that many."
                )
            if tag == "compiler":
                strip = {"true": True, "false": False}.get(values.get("strippath", ""), strip)
                for kind, key in (("texture", "texturedir"), ("mesh", "meshdir")):
                    folders[kind] |= {values[k] for k in (key, "assetdir") if k in values}
            if tag not in DESCRIPTIONS:
                named.update((tag, name) for key, name in values.items() if key.startswith("file"))
            elif "file" in values:
                included.append(values["file"])

        def declared(*_: object) -> None:
            raise InputError(f"{file}: <!DOCTYPE is not read in a robot's description; take it out.")

        parser.StartElementHandler, parser.StartDoctypeDeclHandler = start, declared
        parser.EndElementHandler = lambda _: times.pop() and None
        try:
            content.decode("utf-8")
            parser.Parse(content, True)
        except UnicodeDecodeError:
            raise InputError(
                f"{file}: cannot be read (it is no text in UTF-8); give an MJCF or URDF file."
            ) from None
        except expat.ExpatError as error:
            raise InputError(
                f"{file}, row {error.lineno}: no XML ({expat.ErrorString(error.code)}); give an MJCF or URDF file."
            ) from None
        for name in included:
            # walk through an included file, wherever MuJoCo may look for it
            places = {folder / name for folder in (path.parent, file.parent)}
            for place in places:
                inside(place, f"{file}: <include> of {name}")
            for place in sorted(place for place in places if place.exists()):
                if place.resolve() in met:
                    raise InputError(f"{file}: {name} is included twice or in a circle; include it once.")
                enter(place)

    enter(path)
    # every mesh, texture and the like that is there lies below the description, and is a file
    for tag, name in sorted(named):
        own = name.replace("\\", "/")
        own = own.rsplit("/", 1)[-1] if strip else own
        for folder in folders["texture" if tag == "texture" else "mesh"]:
            # MuJoCo steps back by the name alone, whether the folders in it are there or not
            place = path.parent / os.path.normpath(Path(folder, own))
            try:
                if not os.path.lexists(place):
                    continue
            except ValueError:  # no file can have that name
                continue
            inside(place, f"{path}: the file {name} of a <{tag}>")
            if not place.is_dir() and size_of(place) > LARGEST_MESH:
                raise InputError(f"{place} is larger than {LARGEST_MESH / 1e6:g} MB; give a simpler <{tag}>.")


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
