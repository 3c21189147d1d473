"""Straight-line programs as machine code: traced by JAX, taken apart to scalars, built by LLVM.

XLA computes array by array. For states of 3 to 20 components that means many small loops, and
terms that several outputs share are computed for each of them. Here a traced program becomes a
graph of scalars in which equal terms are one node, and the graph becomes one function with the
loop over events inside and runs side by side in the vector registers.
"""
