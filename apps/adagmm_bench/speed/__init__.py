"""How fast: whole registrations beside other libraries, the kernels beside a matrix product, starting, growing."""
