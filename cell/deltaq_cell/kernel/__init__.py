"""The gate's kernel: certifies tubes and checks distances of many pairs of bodies, compiled, without allocation.

`decision` divides tubes into `pieces` until every pair of bodies is shown to keep apart in them. In each piece
`place` computes the poses of bodies, and `look` finds the pairs that are not shown to keep the requested distance: by
balls, by tight boxes, by the distance at the middle (`gap`), and by planes over a whole span. `span` finds a span
around a path, `course` the setpoints of a motion and its brake. All of them work on `arrays`, which are filled once
and written over and over.
"""
