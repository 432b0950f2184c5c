"""Runs every benchmark program, one after the other, each in its own process."""

import argparse
import subprocess
import sys

from tests.benchmarks.measuring import ROOT

PROGRAMS = "kernels", "reference_images", "terms_curve", "precompute"


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.all", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small trials; RESULTS.md is left as it is")
    arguments = parser.parse_args()
    more = ["--quick"] if arguments.quick else []
    failed = [
        name
        for name in PROGRAMS
        if subprocess.run([sys.executable, "-m", f"tests.benchmarks.{name}", *more], cwd=ROOT, check=False).returncode
    ]
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
