"""kincal calibrates closed-chain (parallel) robots from a handful of measured poses.

The public names stand in `__init__.pyi`; each is imported when it is first used. So `import kincal` takes
milliseconds, and this file, which every stage of the pipeline depends on, stays the same when a name is added.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
