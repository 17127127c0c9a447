# SPDX-License-Identifier: Apache-2.0
"""Arms driven by torque: haptic devices as robot fingers (thesis 2.6), and their force sensors.

`device` says what a device is, `openhaptics` and `emulated` are two of them. `governor` decides
which torque may go out. `rdt` and `net_ft` are the force sensor's protocol and its client.
`servo` is the loop at 2 kHz, a process of its own that ends with torques at zero whatever becomes
of others; `process` is how the node
sees that, `wire` how the two talk.
"""
