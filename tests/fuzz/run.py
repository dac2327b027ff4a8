"""`make fuzz SECONDS=60`: each reader of binary files in a process of its own under atheris (libFuzzer), so long.

Ends with 1 if one of them failed; the bytes that did it lie in OUT (`runs/fuzz`). Without atheris it says why, and ends
with 0: there are wheels for Linux on x86-64 and some versions of Python only.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

from targets import TARGETS, quiet

_MEMORY_MB = 3000
"""Of a process: what torch, numba and ONNX Runtime need, and 2 GB for the file."""
_HANG_S = 20


def fuzz_one(name: str, seconds: int, out: Path) -> None:
    """Runs one target until the time is over, or it fails; does not return."""
    atheris: Any = importlib.import_module("atheris")  # not installed where code is checked
    target = TARGETS[name]
    with atheris.instrument_imports(include=list(target.instrument), enable_loader_override=False):
        for module in target.instrument:
            importlib.import_module(module)
    corpus = out / name
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(target.seeds()):
        (corpus / f"seed{number}").write_bytes(seed)
    longest = max(path.stat().st_size for path in corpus.iterdir())
    options = [
        f"-max_total_time={seconds}",
        f"-timeout={_HANG_S}",
        f"-rss_limit_mb={_MEMORY_MB}",
        f"-max_len={2 * longest}",
        f"-artifact_prefix={out}/{name}-",
        "-print_final_stats=1",
        str(corpus),
    ]

    def once(data: bytes) -> None:
        target.run(data)

    with quiet():
        atheris.Setup([sys.argv[0], *options], once)
        atheris.Fuzz()


def main() -> int:
    """All targets, or those named, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"all, or some of: {', '.join(TARGETS)}")
    parser.add_argument("--seconds", type=int, default=60, help="of each target")
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"), help="corpora, and inputs that fail")
    parser.add_argument("--here", action="store_true", help="the one target in this process")
    args = parser.parse_args()
    for name in args.targets:
        if name not in TARGETS:
            parser.error(f"no target {name!r}, expected some of: {', '.join(TARGETS)}")
    if importlib.util.find_spec("atheris") is None:
        where = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
        print(f"skipped: atheris is not installed; there may be no wheel of it for {where}")
        return 0
    if args.here:
        fuzz_one(args.targets[0], args.seconds, args.out)
    failed = []
    for name in args.targets or TARGETS:
        if missing := TARGETS[name].missing:
            print(f"{name}: skipped, needs {', '.join(missing)}", flush=True)
            continue
        command = [sys.executable, __file__, name, "--here", "--seconds", str(args.seconds), "--out", str(args.out)]
        args.out.mkdir(parents=True, exist_ok=True)
        log = args.out / f"{name}.log"
        with log.open("wb") as stream:
            code = subprocess.run(command, stdout=stream, stderr=subprocess.STDOUT, check=False).returncode
        runs = [line.split()[-1] for line in log.read_text("utf-8", "replace").splitlines() if "executed_units" in line]
        print(f"{name}: {'failed, see ' + str(log) if code else 'no fault'} in {(runs or ['?'])[0]} runs", flush=True)
        failed += [name] if code else []
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
