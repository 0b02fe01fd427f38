"""Every mistake a description or its model can hold, as a way to write it into a folder."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import trimesh
import yaml
from tiny_gripper import GOOD, MODEL, URDF, Edit, put, write

Write = Callable[[Path], object]
Swap = tuple[str, str]
YAML = yaml.safe_dump(GOOD, sort_keys=False)
ACTUATORS = re.search("<actuator>.*</actuator>", MODEL, re.DOTALL)
NO_SHAPE = '<inertial mass="0.1" pos="0 0 0" diaginertia="1e-5 1e-5 1e-5"/>'
PALM = '<box size="0.1 0.04 0.06"/>'


def edited(path: str, value: object) -> Write:
    """Set a field of the gripper.yaml."""
    return lambda folder: write(folder, put(path, value))


def without(path: str) -> Write:
    """Leave a field out of the gripper.yaml."""

    def edit(data: dict) -> None:
        *outer, last = path.split(".")
        for key in outer:
            data = data[key]
        del data[last]

    return lambda folder: write(folder, edit)


def text(content: str | bytes) -> Write:
    """Write the gripper.yaml as it is given."""
    raw = content.encode() if isinstance(content, str) else content
    return lambda folder: (write(folder) / "gripper.yaml").write_bytes(raw)


def model(
    *swaps: Swap, edit: Edit | None = None, of: str = MODEL, name: str = "model.xml"
) -> Write:
    """Replace pieces of the model; the gripper.yaml may be changed by `edit`."""
    content = of
    for old, new in swaps:
        assert old in content, old
        content = content.replace(old, new)
    return lambda folder: write(folder, edit, content, name)


def urdf(*swaps: Swap) -> Write:
    """Replace pieces of the URDF."""
    return model(*swaps, of=URDF, name="model.urdf")


def added(before: str, piece: str, edit: Edit | None = None) -> Write:
    """Add a piece to the MJCF before a tag."""
    return model((before, piece + before), edit=edit)


def palm_mesh(file: str, content: bytes | None = None) -> Write:
    """Give the URDF's palm a mesh; `content` is that of the file, None where there is none."""
    written = urdf((PALM, f'<mesh filename="{file}"/>'))

    def both(folder: Path) -> None:
        written(folder)
        if content is not None:
            (folder / file).write_bytes(content)

    return both


def removed(name: str) -> Write:
    """Delete a file of the good gripper."""
    return lambda folder: (write(folder) / name).unlink()


def yaml_is_a_folder(folder: Path) -> None:
    """Put a folder where the gripper.yaml is expected."""
    removed("gripper.yaml")(folder)
    (folder / "gripper.yaml").mkdir()


def millimetres(folder: Path) -> None:
    """Scale all lengths of the model."""
    large = re.sub(
        r'(size|pos|range|ctrlrange)="([^"]*)"',
        lambda m: f'{m[1]}="{" ".join(f"{1000 * float(x):g}" for x in m[2].split())}"',
        MODEL,
    )
    write(folder, model=large)


def coupled(coefficients: str) -> Swap:
    """Couple the right slide to the left one by a polynomial."""
    return (
        "<actuator>",
        f'<equality><joint joint1="slide_r" joint2="slide_l" polycoef="{coefficients}"/>'
        "</equality><actuator>",
    )


def both(*edits: Edit) -> Edit:
    """Do several edits."""
    return lambda data: [edit(data) for edit in edits]


LEFT_ONLY = put("postures.closed.joints", {"slide_l": 0.02})
CONTROLS = {"actuators": {"drive": 0.02, "slide_r": 0.02}}
STIFF = {"kp": 1e12, "force": 1e12}

LOAD: dict[str, Write] = {
    # the file
    "no file": removed("gripper.yaml"),
    "folder instead of the file": yaml_is_a_folder,
    "empty file": text(""),
    "list at the top": text("- a\n- b\n"),
    "text at the top": text("a gripper"),
    "tab": text(YAML.replace("  open:", "\topen:")),
    "broken YAML": text("name: ["),
    "nested too deeply": text("[" * 5000),
    "impossible date": text(YAML.replace("source: test", "source: 2026-13-45")),
    "not UTF-8": text(YAML.replace("Tiny", "Größe").encode("latin-1")),
    "field given twice": text(YAML + "tcp: [0, 0, 0.1]\n"),
    "joint given twice": text(YAML.replace("slide_r: 0.024", "slide_l: 0.024")),
    # fields
    "unknown field": edited("tpc", [0, 0, 1]),
    "unknown field unlike any": edited("colour", "red"),
    "missing field": without("tcp"),
    "missing field of a pose": without("mount_from_model.quat"),
    "unknown field of a pose": edited("mount_from_model.rpy", [0, 0, 0]),
    "number for a pose": edited("mount_from_model", 3),
    "null for a mapping": edited("postures", None),
    "other format": edited("format", 2),
    "format as text": edited("format", "1"),
    "name with a space": edited("name", "No Spaces"),
    "number for a text": edited("source", 123),
    "empty text": edited("licence", ""),
    "unknown kind": edited("kind", "paralel"),
    "model of another suffix": edited("model", "model.stl"),
    "tcp of two numbers": edited("tcp", [0, 0]),
    "tcp with a text": edited("tcp", [0, 0, "a"]),
    "tcp with nan": edited("tcp", [0, 0, float("nan")]),
    "tcp with a number YAML takes for a text": text(YAML.replace("0.08", "8e-2")),
    "tcp in millimetres": edited("tcp", [0, 0, 80]),
    "tcp behind the palm": edited("tcp", [0, 0, -0.1]),
    "tcp in the palm's plane": edited("tcp", [0, 0, 0]),
    "mount in millimetres": edited("mount_from_model.xyz", [0, 0, 30]),
    "quaternion not unit": edited("mount_from_model.quat", [0, 0, 0.7, 0.7]),
    "quaternion zero": edited("mount_from_model.quat", [0, 0, 0, 0]),
    "quaternion of three": edited("mount_from_model.quat", [0, 0, 1]),
    "flange not unit": edited("flange_from_gripper", {"xyz": [0, 0, 0], "quat": [0, 0, 1, 1]}),
    "third posture": edited("postures.half", {}),
    "no closed posture": without("postures.closed"),
    "joints and actuators": edited("postures.open.actuators", {"drive": 0}),
    "neither joints nor actuators": edited("postures.open", {}),
    "unknown field of a posture": edited("postures.open", {"joint": {"slide_l": 0}}),
    "no joints in a posture": edited("postures.open.joints", {}),
    "number as a joint's name": edited("postures.open.joints", {1: 0.0}),
    "text as a joint's position": edited("postures.open.joints.slide_l", "far"),
    "inf as a joint's position": edited("postures.open.joints.slide_l", float("inf")),
    "number YAML takes for a text": text(YAML.replace("slide_l: 0.024", "slide_l: 24e-3")),
    "whole number beyond floats": edited("postures.open.joints.slide_l", 10**400),
    "whole number beyond printing": text(YAML.replace("tcp:\n- 0", "tcp:\n- 0x1" + "0" * 4000)),
    "list for the actuation": edited("actuation", ["slide_l"]),
    "number as a drive's name": edited("actuation", {1: {"kp": 1, "force": 1}}),
    "unknown field of a drive": edited("actuation.slide_r.kd", 1),
    "drive without force": without("actuation.slide_r.force"),
    "kp zero": edited("actuation.slide_r.kp", 0),
    "damping negative": edited("actuation.slide_r.damping", -1),
    "no max_width of a jaw": edited("max_width", None),
    "max_width zero": edited("max_width", 0),
    "max_width in millimetres": edited("max_width", 52),
    "min_width negative": edited("min_width", -1),
    "min_width over max_width": edited("min_width", 0.06),
    "symmetry zero": edited("symmetry", 0),
    "symmetry a fraction": edited("symmetry", 1.5),
    "one finger group": edited("fingers", [["left"]]),
    "long fingers": edited("fingers", "left right" * 50),
    "finger twice": edited("fingers", [["left"], ["left"]]),
    # how the description fits the model
    "no model": removed("model.xml"),
    "model elsewhere": edited("model", "meshes/model.xml"),
    "name of a model too long": edited("model", "m" * 300 + ".xml"),
    "asset without the variable": edited("model", "asset:tiny/model.xml"),
    "unknown finger": edited("fingers", [["left"], ["rigth"]]),
    "unknown drive": edited("actuation.slide", {"kp": 1, "force": 1}),
    "unknown joint in a posture": edited("postures.open.joints.slide_m", 0.0),
    "joint missing in a posture": without("postures.open.joints.slide_r"),
    "posture outside the limits": edited("postures.closed.joints.slide_l", 0.04),
    "coupled joint outside the limits": model(coupled("0 3 0 0 0"), edit=LEFT_ONLY),
    "unknown actuator in a posture": edited("postures.closed", {"actuators": {"motor": 1}}),
    "control outside the range": edited("postures.closed", {"actuators": {"drive": 1}}),
    "no actuators in the model": model(
        (ACTUATORS[0] if ACTUATORS else "", ""),
        edit=both(put("actuation", {}), put("postures.closed", CONTROLS)),
    ),
    "posture that does not settle": model(
        edit=both(put("actuation.slide_r", STIFF), put("postures.closed", CONTROLS))
    ),
    # the model file
    "model without contents": model((MODEL, "")),
    "model is no XML": model((MODEL, "hello")),
    "model is an SDF": model((MODEL, "<sdf/>")),
    "model is a xacro": urdf(
        ("<robot ", '<robot xmlns:xacro="ros.org/xacro" '), ("<visual>", "<xacro:a/><visual>")
    ),
    "model of unknown elements": model(('type="box"', 'typ="box"')),
    "joints of one name": model(('"slide_r" type', '"slide_l" type')),
    "bodies of one name": model(('body name="right"', 'body name="left"')),
    "links of one name": urdf(('link name="right"', 'link name="left"')),
    "joints of one name, URDF": urdf(('joint name="slide_r"', 'joint name="slide_l"')),
    "link of the loader's name": model(('body name="palm"', 'body name="gripper"')),
    "no moving joint": urdf(("prismatic", "fixed")),
    "free joint": added('<body name="left"', "<freejoint/>"),
    "ball joint": model(('type="slide" axis="1 0 0" range="0 0.03"', 'type="ball"')),
    "floating joint": urdf(("prismatic", "floating")),
    "unknown joint type": urdf(("prismatic", "prismatc")),
    "unknown child link": urdf(('child link="right"', 'child link="rigth"')),
    "no parent link": urdf(('<parent link="palm"/>', "")),
    "link below two joints": urdf(('child link="right"', 'child link="left"')),
    "links in a ring": urdf(
        ('<parent link="palm"/><child link="left"/>', '<parent link="left"/><child link="left"/>')
    ),
    "axis zero": urdf(('xyz="1 0 0"', 'xyz="0 0 0"')),
    "axis of two numbers": urdf(('xyz="1 0 0"', 'xyz="1 0"')),
    "axis of words": urdf(('xyz="1 0 0"', 'xyz="x y z"')),
    "axis nan": urdf(('xyz="1 0 0"', 'xyz="nan 0 0"')),
    "axis not unit": urdf(('xyz="1 0 0"', 'xyz="1 1 0"')),
    "axis zero, MJCF": model(('axis="1 0 0"', 'axis="0 0 0"')),
    "axis nan, MJCF": model(('axis="1 0 0"', 'axis="nan 0 0"')),
    "limits swapped": urdf(('lower="0" upper="0.03"', 'lower="0.03" upper="0"')),
    "limits swapped, MJCF": model(('axis="1 0 0" range="0 0.03"', 'axis="1 0 0" range="0.03 0"')),
    "mimic of an unknown joint": urdf(
        ("</joint>\n</robot>", '<mimic joint="slidel"/></joint></robot>')
    ),
    "mimic of itself": urdf(("</joint>\n</robot>", '<mimic joint="slide_r"/></joint></robot>')),
    "mimics in a ring": urdf(
        ("</joint>\n</robot>", '<mimic joint="slide_l"/></joint></robot>'),
        ("</joint>", '<mimic joint="slide_r"/></joint>'),
    ),
    "coupling of an unknown joint": model(
        coupled("0 1 0 0 0"), ('joint2="slide_l"', 'joint2="slide"')
    ),
    "actuator of an unknown joint": model(('joint="slide_l"', 'joint="slide"')),
    "tendon of an unknown joint": added(
        "<actuator>", '<tendon><fixed><joint joint="slide" coef="1"/></fixed></tendon>'
    ),
    "loop to an unknown body": added(
        "<actuator>", '<equality><connect body1="left" body2="thumb" anchor="0 0 0"/></equality>'
    ),
    "missing mesh": palm_mesh("meshes/palm.stl"),
    "missing mesh, MJCF": added("<worldbody>", '<asset><mesh name="a" file="a.obj"/></asset>'),
    "mesh in a package": palm_mesh("package://tiny_description/meshes/palm.stl"),
    "mesh by URL": palm_mesh("file:///meshes/palm.stl"),
    "mesh of another kind": palm_mesh("palm.dae", b"<COLLADA/>"),
    "broken mesh": palm_mesh("palm.stl", b"solid"),
    "mesh that is flat": palm_mesh(
        "palm.stl", trimesh.creation.box((1, 1, 0)).export(file_type="stl")
    ),
    "link without mass": model(('<geom name="pad_l" type="box" size="0.004 0.01 0.03"/>', "")),
    "no shapes": lambda folder: write(folder, model=re.sub("<geom[^>]*/>", NO_SHAPE, MODEL)),
    "position nan": model(('pos="0.03 0 0.06"', 'pos="nan 0 0.06"')),
    "model in millimetres": millimetres,
}

CHECK: dict[str, Write] = {
    "good": write,
    "wrong description": edited("format", 2),
    "palm in front of the TCP": edited("tcp", [0, 0, 0.01]),
    "TCP beyond the fingers": edited("tcp", [0, 0, 0.5]),
    "TCP beside the fingers": edited("tcp", [0.1, 0, 0.08]),
    "swapped fingers": edited("fingers", [["right"], ["left"]]),
    "swapped postures": lambda folder: write(
        folder,
        both(
            put("postures.open", GOOD["postures"]["closed"]),
            put("postures.closed", GOOD["postures"]["open"]),
        ),
    ),
    "postures alike": edited("postures.closed", GOOD["postures"]["open"]),
    "closing along Y": edited("mount_from_model.quat", [0, 0, 0.70710678, 0.70710678]),
    "jaw that passes a fixed one": model(
        ('pos="-0.03 0 0.06"', 'pos="-0.03 0.05 0.06"'),
        edit=put("postures.closed.joints.slide_l", 0.0),
    ),
    "upside down": edited("mount_from_model.quat", [1, 0, 0, 0]),
    "finger without collision geometry": model(('name="pad_l"', 'contype="0" conaffinity="0"')),
    "no drives": model((ACTUATORS[0] if ACTUATORS else "", ""), edit=put("actuation", {})),
    "weak drive": edited("actuation.slide_r", {"kp": 1, "force": 1, "damping": 1}),
    "unstable drive": edited("actuation.slide_r", STIFF),
    "max_width too large": edited("max_width", 0.09),
    "symmetry that is none": edited("symmetry", 3),
    "posture off a coupling": model(
        coupled("0 1 0 0 0"), edit=put("postures.closed.joints.slide_r", 0.014)
    ),
}
