"""Arrival times of blade tips at probes, and the vibration that is fitted to them.

The folder needs ``basics`` and ``numerics`` alone: neither meshes, structures nor scenes, which
``monitoring`` ties to it. ``arrival_times`` holds the times of one blade, and reads and writes
records. ``fit_order`` finds engine orders and tracks one through a run-up, ``fit_frequency`` a
frequency that is no multiple of the speed, ``passages`` the resonances that a run-up passes.
``harmonics`` has the result of a fit, ``robust`` and ``transient`` their numerical methods.
"""
