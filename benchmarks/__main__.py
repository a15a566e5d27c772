"""`python -m benchmarks [NAME ...]`: runs the named benchmarks, all of them by default."""

from __future__ import annotations

import importlib
import pkgutil
import sys
import time

import benchmarks


def main() -> int:
    names = sorted(m.name for m in pkgutil.iter_modules(benchmarks.__path__) if not m.name.startswith("_"))
    wanted = sys.argv[1:] or names
    for name in wanted:
        if name not in names:
            print(f"no benchmark '{name}'; there are: {', '.join(names)}", file=sys.stderr)
            return 2
        print(f"\n=== {name}", flush=True)
        began = time.monotonic()
        importlib.import_module(f"benchmarks.{name}").main()
        print(f"({time.monotonic() - began:.0f} s)", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
