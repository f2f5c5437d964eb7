"""The experiments of the papers and the benchmarks: each a function from a cell to a table and a figure."""
