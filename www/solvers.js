// Which solvers take seconds.

/** Their normals are made in pieces by the helpers, and their errors are not known after every light of a run. */
export const IN_PIECES = ["pixel", "context"];
