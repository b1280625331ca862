"""Keep a random sample of a session's mutants, so many of each package: `python -m tests.mutation_sample SESSION`.

The others are marked as skipped. Mutants of annotations are none: those are never evaluated.
"""

from __future__ import annotations

import ast
import random
import sys
from argparse import ArgumentParser, Namespace
from collections import defaultdict
from functools import cache
from pathlib import Path

from cosmic_ray.tools.filters.filter_app import FilterApp
from cosmic_ray.work_db import WorkDB
from cosmic_ray.work_item import MutationSpec, WorkerOutcome, WorkItem, WorkResult


class Sample(FilterApp):
    """Skips all mutants but a sample."""

    def add_args(self, parser: ArgumentParser) -> None:
        """Add the size of the sample, and its seed."""
        parser.add_argument("--per-package", type=int, default=70)
        parser.add_argument("--seed", type=int, default=0)

    def filter(self, work_db: WorkDB, args: Namespace) -> None:
        """Mark what is not in the sample as skipped."""
        by_package: dict[str, list[WorkItem]] = defaultdict(list)
        for item in sorted(work_db.pending_work_items, key=_place):
            by_package[package(item.mutations[0].module_path)].append(item)
        for name, items in sorted(by_package.items()):
            evaluated = [item for item in items if not is_annotation(item.mutations[0])]
            kept = random.Random(f"{args.seed} {name}").sample(evaluated, min(args.per_package, len(evaluated)))
            print(f"{name}: {len(kept)} of {len(evaluated)} mutants")
            chosen = {item.job_id for item in kept}
            for item in items:
                if item.job_id not in chosen:
                    work_db.set_result(item.job_id, WorkResult(WorkerOutcome.SKIPPED, "not in the sample"))


def package(module: Path) -> str:
    """Return the package of a module, such as `rl`."""
    return module.parts[1] if module.parts[0] == "mapf_pz" else module.parts[0]


def is_annotation(mutation: MutationSpec) -> bool:
    """Tell whether a mutation lies in an annotation."""
    return any(begin <= mutation.start_pos < end for begin, end in _annotations(mutation.module_path))


@cache
def _annotations(module: Path) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return where the annotations of a module begin and end: line and column."""
    nodes = list(ast.walk(ast.parse(module.read_text("utf-8"))))
    parts = [getattr(node, name, None) for node in nodes for name in ("annotation", "returns")]
    return [
        ((part.lineno, part.col_offset), (part.end_lineno or 0, part.end_col_offset or 0))
        for part in parts
        if isinstance(part, ast.expr)
    ]


def _place(item: WorkItem) -> tuple[str, tuple[int, int], str, int]:
    mutation = item.mutations[0]
    return str(mutation.module_path), mutation.start_pos, mutation.operator_name, mutation.occurrence


if __name__ == "__main__":
    sys.exit(Sample().main())
