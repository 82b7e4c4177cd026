"""Tuples of numbers, entry by entry.

A thread keeps a tuple in its registers only where every index is a literal. So a function for `count` entries is made
of the same for one less; the compiler makes straight code of them all, as if each entry had a line of its own.
"""


def adder(count, decorate):
    """(a, b) → their sums, entry by entry; `decorate` is `front_end.exact` or `front_end.fast`."""
    if count == 1:

        @decorate
        def add(a, b):
            return (a[0] + b[0],)

    else:
        add_rest = adder(count - 1, decorate)

        @decorate
        def add(a, b):
            return (a[0] + b[0], *add_rest(a[1:], b[1:]))

    return add


def column_loader(count, decorate):
    """(rows, first, m) → rows[first, m], ..., rows[first + count - 1, m]."""
    if count == 1:

        @decorate
        def load(rows, first, m):
            return (rows[first, m],)

    else:
        load_rest = column_loader(count - 1, decorate)

        @decorate
        def load(rows, first, m):
            return (rows[first, m], *load_rest(rows, first + 1, m))

    return load


def column_storer(count, decorate):
    """(rows, first, m, values): values[i] into rows[first + i, m]."""
    if count == 1:

        @decorate
        def store(rows, first, m, values):
            rows[first, m] = values[0]

    else:
        store_rest = column_storer(count - 1, decorate)

        @decorate
        def store(rows, first, m, values):
            rows[first, m] = values[0]
            store_rest(rows, first + 1, m, values[1:])

    return store
