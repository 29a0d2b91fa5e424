"""General tools, independent of slippers and dynamics: compiling, batching, sums, checks of arguments, files."""
