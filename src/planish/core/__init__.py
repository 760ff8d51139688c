"""What all stages share: errors, grids, transforms, options, results, tables, threads. It imports no stage."""
