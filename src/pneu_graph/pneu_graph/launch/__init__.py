# SPDX-License-Identifier: Apache-2.0
"""Launch files in the YAML front-end format of `ros2 launch`: reading, planning, supervising."""
