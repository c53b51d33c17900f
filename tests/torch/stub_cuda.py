"""Empty libraries in the place of CUDA's, so that PyTorch's wheel can be imported on a CPU.

The wheel asks for 2.5 GB of libraries that a CPU never calls. `stub_cuda.py LIBTORCH OUT` writes a
library for each of them to OUT, with the symbols that must exist when the wheel is loaded.
"""

import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

FOREIGN = re.compile(r"lib(cu|nv|nccl)")
SYMBOL = re.compile(r"(cu|nv|nccl)")
# Symbols of this version, and those without one, belong to these libraries.
VERSION_OF = {"NVSHMEM": "libnvshmem_host.so"}
UNVERSIONED = "libcudnn.so"


def run(*command: object) -> str:
    return subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True).stdout


def main() -> None:
    libtorch, out = Path(sys.argv[1]), Path(sys.argv[2])
    out.mkdir(parents=True, exist_ok=True)
    there = {path.name for path in libtorch.rglob("*.so*")}
    needed: set[str] = set()
    symbols: dict[str, set[str]] = defaultdict(set)
    for library in sorted((libtorch / "torch" / "lib").glob("*.so")):
        found = re.findall(r"NEEDED.*\[(.*)\]", run("readelf", "-d", library))
        needed |= {name for name in found if FOREIGN.match(name) and name not in there}
        for line in run("nm", "-D", "--undefined-only", library).splitlines():
            symbol, _, version = line.split()[-1].partition("@")
            if SYMBOL.match(symbol):
                symbols[version.lstrip("@")].add(symbol)
    for name in sorted(needed):
        versions = [version for version in symbols if VERSION_OF.get(version, version or UNVERSIONED) in name]
        with tempfile.TemporaryDirectory() as scratch:
            source, script = Path(scratch) / "stub.c", Path(scratch) / "stub.map"
            bodies = [f"void {symbol}(void) {{}}" for version in versions for symbol in sorted(symbols[version])]
            source.write_text("\n".join(bodies))
            named = [version for version in versions if version]
            script.write_text(
                "".join(f"{version} {{ global: {'; '.join(sorted(symbols[version]))}; }};\n" for version in named)
            )
            options = [f"-Wl,--version-script={script}"] if named else []
            run("cc", "-shared", "-fno-builtin", "-w", f"-Wl,-soname,{name}", *options, "-o", out / name, source)


if __name__ == "__main__":
    main()
