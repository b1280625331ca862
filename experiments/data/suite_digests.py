"""Record the digests of bundled suites in their files: `python -m experiments.data.suite_digests`.

Only files without a digest are changed: after a change of a suite, increase its version, delete its digest, and run
this.
"""

from __future__ import annotations

import re

from mapf_pz._internal.atomic import write_whole
from mapf_pz.evaluation import load_suite, suite_names
from mapf_pz.evaluation.suite import suite_file


def main() -> None:
    """Add the member `digest` after `version` to each file without one, and print the suite."""
    for name in suite_names():
        file = suite_file(name)
        text = file.read_text("utf-8")
        if '"digest"' not in text:
            label = load_suite(name)[0].suite
            digest = label.rpartition(" ")[2]
            write_whole(file, re.sub(r'("version": \d+,)', rf'\1\n  "digest": "{digest}",', text, count=1).encode())
            print(label)


if __name__ == "__main__":
    main()
