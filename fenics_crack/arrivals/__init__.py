"""Read arrival times of blade tips at probes, and fit their vibration.

The folder needs ``basics`` and ``numerics`` alone. ``monitoring`` connects it with meshes,
structures and scenes.

- ``arrival_times`` holds the times for one blade, and reads and writes records.
- ``fit_order`` finds engine orders.
- ``track_order`` follows one order through a run-up.
- ``fit_frequency`` finds a frequency that is no multiple of the speed.
- ``passages`` finds the resonances in a run-up.
- ``resonance`` fits a mode and an engine order to one of them.
- ``harmonics`` holds the result of a fit.
- ``robust`` and ``transient`` hold the numerical methods.
"""
