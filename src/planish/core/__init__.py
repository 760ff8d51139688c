"""What all stages share: errors, grids, transforms, options, results, tables, threads.

It imports no stage.

``frame`` says how the sheet lies in the array, ``grid`` where pixels are, ``transform`` how one map
goes to another; ``arrays`` checks what a function is given. ``options`` holds what a parameter is:
an option stands once, in the module ``params`` of its stage; ``parameter_faults`` names what is
wrong in a file of them. ``facts`` and ``checks`` are what results are made of; ``status`` says why
a value is missing. ``area``, ``bands``, ``lazy`` and ``tiles`` keep large data out of the memory,
``memory`` reckons what a run takes, ``threads`` how many may work. ``robust`` holds statistics that
outliers and gaps do not spoil. ``files``, ``tables``, ``text`` and ``matlab`` read and write;
``jit`` compiles kernels, ``source_hash`` tells results of this code from others and whom to tell of
a fault, ``plugins`` finds what other packages add.
"""
