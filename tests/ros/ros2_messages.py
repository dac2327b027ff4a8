"""Builds what ROS 2's wheels lack for the tests: tf2_msgs/TFMessage and nav2_msgs/action/NavigateToPose, with the
wheels' own generators and a compiler, without CMake. Run by the Python that has ROS 2; prints the folder to put on
PYTHONPATH and LD_LIBRARY_PATH. Robots have both packages from their distribution.

python ros2_messages.py [FOLDER]

What is built is kept (in the environment, if no folder is named) and built again only when this file or the wheels
change. Ends with CANNOT_BUILD where it cannot build, naming what is missing.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import contextlib
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from importlib.metadata import version
from pathlib import Path

PACKAGES = {
    "tf2_msgs": {"msg/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n"},
    "nav2_msgs": {
        "action/NavigateToPose.action": """\
geometry_msgs/PoseStamped pose
string behavior_tree
---
uint16 NONE=0
uint16 UNKNOWN=9000
uint16 FAILED_TO_LOAD_BEHAVIOR_TREE=9001
uint16 TF_ERROR=9002
uint16 TIMEOUT=9003
uint16 error_code
string error_msg
---
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
"""
    },
}
"""The public definitions of Kilted, without their comments (which no message's hash counts)."""
_SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
_NEEDED = (
    "action_msgs",
    "builtin_interfaces",
    "geometry_msgs",
    "service_msgs",
    "std_msgs",
    "unique_identifier_msgs",
)
CANNOT_BUILD = 3
"""How it ends where it cannot."""
_ROOT = Path(sys.prefix)
_C, _CXX = (shlex.split(os.environ.get(name, default)) for name, default in (("CC", "cc"), ("CXX", "c++")))


class CannotBuildError(Exception):
    """No compiler, or no headers of Python."""


def build(folder: Path) -> Path:
    """Both packages, in a folder under `folder` whose name says what they were built from.

    Raises:
        CannotBuildError: naming what a build takes and is not there.
        RuntimeError: with the compiler's words, if it fails.
    """
    made_of = Path(__file__).read_bytes() + "".join(map(version, ("ros-rclpy", "ros-rosidl-generator-py"))).encode()
    done = folder / hashlib.sha256(made_of).hexdigest()[:16]
    if done.is_dir():
        return done
    for program in (_C[0], _CXX[0]):
        if shutil.which(program) is None:
            raise CannotBuildError(f"no compiler {program!r}")
    header = Path(sysconfig.get_path("include"), "Python.h")
    if not header.is_file():
        raise CannotBuildError(f"no {header}")
    folder.mkdir(parents=True, exist_ok=True)
    # Whole or not at all: whoever is interrupted leaves nothing that looks finished.
    with tempfile.TemporaryDirectory(dir=folder) as tmp:
        for package, files in PACKAGES.items():
            _build_package(package, files, Path(tmp))
            _try(package, files, Path(tmp) / "python")
        result = Path(tmp) / "python"
        try:
            result.rename(done)
        except OSError:  # somebody else was faster
            if not done.is_dir():
                raise
    return done


def _build_package(package: str, files: dict[str, str], tmp: Path) -> None:
    sources, python = tmp / "sources", tmp / "python" / package
    for name, text in files.items():
        (sources / package / name).parent.mkdir(parents=True, exist_ok=True)
        (sources / package / name).write_text(text)
    _generate(package, list(files), sources)
    written = sources / "py" / package
    for module in written.rglob("*.py"):
        target = python / module.relative_to(written)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(module, target)
    (python / "__init__.py").touch()
    _compile(package, sources, python / f"{package}_s__rosidl_typesupport_c.so")


def _generate(package: str, files: list[str], sources: Path) -> None:
    """C, its support for DDS and Python, each into a folder of its own: some files bear the same names."""
    import rosidl_adapter.action
    import rosidl_adapter.msg
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    os.environ["AMENT_PREFIX_PATH"] = str(_ROOT)  # where the generators look for their templates
    root = sources / package
    for name in files:
        kind = name.partition("/")[0]
        convert = getattr(getattr(rosidl_adapter, kind), f"convert_{kind}_to_idl")
        convert(root, package, Path(name), root / kind)
    idl = [f"{root}:{Path(name).with_suffix('.idl')}" for name in files]
    inputs = (package, idl, [str(_ROOT / "share")])
    hashes = HashTypeDescription("type_description").generate_type_hashes(*inputs, root)
    GenerateC("c").generate(*inputs, sources / "c" / package, [str(path) for path in hashes])
    for name, generator in (
        ("fastrtps", GenerateFastRTPSCTypesupport("fastrtps_c")),
        ("introspection", GenerateIntrospectionCTypesupport("introspection_c")),
        ("dispatch", GenerateCTypesupport("c", typesupport_implementations=list(_SUPPORTS))),
        ("py", GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"])),
    ):
        generator.generate(*inputs, sources / name / package)


def _compile(package: str, sources: Path, out: Path) -> None:
    """Everything into one Python extension; what it needs of other packages lies in the wheels' libraries."""
    import numpy as np

    kinds = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", *_SUPPORTS)
    names = [f"{name}__{kind}" for name in _NEEDED for kind in kinds]
    names += ["rosidl_runtime_c", "rosidl_typesupport_c", *_SUPPORTS, "rosidl_typesupport_fastrtps_cpp"]
    libraries = [f"-l{name}" for name in (*names, "fastcdr", "rcutils")]
    own = [path for path in sources.iterdir() if (path / package).is_dir()]
    headers = [path for path in sorted((_ROOT / "include").iterdir()) if path.is_dir()]
    include = (*own, *headers, _ROOT / "include", np.get_include(), sysconfig.get_path("include"))
    options = ["-O0", "-fPIC", "-w", *(f"-I{path}" for path in include)]
    objects = []
    for source in sorted(path for path in sources.glob(f"*/{package}/**/*") if path.suffix in (".c", ".cpp")):
        objects.append(f"{source}.o")
        compiler = _C if source.suffix == ".c" else _CXX
        _call([*compiler, *options, "-c", str(source), "-o", objects[-1]])
    _call([*_CXX, "-shared", "-o", str(out), *objects, f"-L{_ROOT / 'lib'}", "-Wl,--as-needed", *libraries])
    for support in _SUPPORTS:  # looked for by these names
        (out.parent.parent / f"lib{package}__{support}.so").symlink_to(out.relative_to(out.parent.parent))


def _try(package: str, files: dict[str, str], python: Path) -> None:
    """Loads every type in a process of its own, as whoever uses them will."""
    libraries = os.pathsep.join(filter(None, (str(python), os.environ.get("LD_LIBRARY_PATH"))))
    for name in files:
        module, kind = f"{package}.{name.partition('/')[0]}", Path(name).stem
        lines = f"import sys; sys.path.insert(0, {str(python)!r})\nfrom {module} import {kind}"
        _call(
            [sys.executable, "-c", f"{lines}\n{kind}.__class__.__import_type_support__()"],
            env={**os.environ, "LD_LIBRARY_PATH": libraries},
        )


def _call(command: list[str], env: dict[str, str] | None = None) -> None:
    done = subprocess.run(command, capture_output=True, text=True, env=env)
    if done.returncode:
        raise RuntimeError(f"{shlex.join(command)}\n{done.stderr[-4000:]}")


if __name__ == "__main__":
    try:
        with contextlib.redirect_stdout(sys.stderr):  # the generators say what they read
            built = build(Path(sys.argv[1]) if len(sys.argv) > 1 else _ROOT / "extra_messages")
    except CannotBuildError as error:
        print(error, file=sys.stderr)
        sys.exit(CANNOT_BUILD)
    print(built)
