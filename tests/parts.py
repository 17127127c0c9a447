# SPDX-License-Identifier: Apache-2.0
"""Which tests run against the clock, and in which order tests begin."""

REALTIME = (
    "src/pneu_hw_bridge/test/",
    "src/pneu_policy/test/test_play_node",
    "src/pneu_policy/test/test_policy_nodes",
    "src/pneu_policy/test/test_robot_node",
    "src/pneu_graph/test/test_recorder",
    "src/pneu_sim/test/test_simulator_node",
    "src/pneu_sim/test/test_view",
    "src/pneu_sysid/test/test_identify_node",
    "src/pneu_sysid/test/test_replay_node",
    "tests/conformance/test_executors",
    "tests/conformance/test_timers",
    "tests/test_faults",
    "tests/test_graph",
    "tests/test_hand_graph",
    "tests/test_live_experiments",
    "tests/test_pressure_study",
    "tests/test_robot",
    "tests/test_workbench_live",
)
"""Beginnings of the paths of tests that run against the clock."""

MIXED = ("src/pneu_sim/test/test_stepper",)
"""Likewise of files in which single tests do, marked there."""

COMPILING = "src/pneu_sysid/test/test_compare_moving"
"""Beginning of the path of a test that has most kernels compiled, which takes a minute."""

WITHOUT_KERNELS = (
    "tests/test_house",
    "src/pneu_graph/test/test_bag",
    "src/pneu_graph/test/test_launch",
    "src/pneu_graph/test/test_tools",
    "src/pneu_runtime/test/",
    "tests/conformance/",
    "src/pneu_common/test/",
    "tests/test_docstrings",
)
"""Likewise of tests that need none: they run meanwhile, or others would compile the same again."""

LONGEST = (
    "tests/test_workbench.py",
    "src/pneu_sim/test/test_cuda",
    "src/pneu_sysid/test/test_design",
    "src/pneu_sim/test/test_match",
    "tests/test_faults.py",
    "tests/test_workbench_live",
    "tests/test_robot_control",
    "tests/test_graph",
    "tests/test_robot_graph",
    "src/pneu_policy/test/test_policy_nodes",
    "src/pneu_hw_bridge/test/test_valve_bridge",
    "tests/test_faults_simulated",
    "tests/test_pressure_study",
    "src/pneu_sysid/test/test_identify_node",
    "src/pneu_hw_bridge/test/test_faults",
    "src/pneu_graph/test/test_recorder",
    "tests/test_hidden_effects",
    "src/pneu_sysid/test/test_observe_command",
    "tests/test_real_data",
    "tests/test_several_recordings",
    "src/pneu_sysid/test/test_exact",
    "src/pneu_sysid/test/",
)
"""Likewise of tests that take longest: they begin first, so that no worker is left alone with one
of them at the end."""

ORDER = (COMPILING, *WITHOUT_KERNELS, *LONGEST)
"""Beginnings of paths in the order in which tests begin. Wants `--no-loadscope-reorder`."""
