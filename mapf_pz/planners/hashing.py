"""A hash table of rows of integers, with open addressing.

A table of up to K rows is any tuple with the fields `rows` (K, N) int32, `key` (K,) uint64, the hash of each row, and
`slots` (2 * K,) int32, the numbers of the rows, where `EMPTY` marks an empty slot.
"""

from __future__ import annotations

import numpy as np

from mapf_pz._internal.jit import Array, jit

EMPTY = -1


@jit
def hash_row(row: Array) -> np.uint64:
    """Return an unsigned 64-bit hash of a row (FNV-1a, one number at a time)."""
    key = np.uint64(14695981039346656037)
    for number in row:
        key = (key ^ np.uint64(number)) * np.uint64(1099511628211)
    return key ^ (key >> np.uint64(32))


@jit
def find_slot(table: Array, row: Array, key: np.uint64) -> np.uint64:
    """Return the slot of the row that equals `row`, whose hash is `key`, or the empty slot for it."""
    size = np.uint64(table.slots.size)
    slot = key % size
    while True:
        number = table.slots[slot]
        if number == EMPTY or (table.key[number] == key and _equal(table.rows[number], row)):
            return slot
        slot = (slot + np.uint64(1)) % size


@jit
def refill_slots(table: Array, count: int) -> None:
    """Write the slots of the first `count` rows after the capacity has changed; of equal rows, the last is found."""
    table.slots[:] = EMPTY
    for number in range(count):
        table.slots[find_slot(table, table.rows[number], table.key[number])] = number


@jit
def _equal(one: Array, other: Array) -> bool:
    i = 0  # np.array_equal takes long to compile
    while i < one.size and one[i] == other[i]:
        i += 1
    return i == one.size
