# SPDX-License-Identifier: Apache-2.0
"""Quality of service profiles."""

import pytest
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    InvalidQoSProfileException,
    LivelinessPolicy,
    QoSCompatibility,
    QoSPresetProfiles,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
    qos_profile_parameters,
    qos_profile_sensor_data,
    qos_profile_services_default,
    qos_profile_system_default,
)

pytestmark = pytest.mark.kernel_free


def test_history_or_depth_is_needed():
    with pytest.raises(InvalidQoSProfileException):
        QoSProfile()
    with pytest.raises(InvalidQoSProfileException):
        QoSProfile(history=HistoryPolicy.KEEP_LAST)
    assert QoSProfile(history=HistoryPolicy.KEEP_ALL).history is HistoryPolicy.KEEP_ALL


def test_defaults():
    profile = QoSProfile(depth=7)
    assert profile.history is HistoryPolicy.KEEP_LAST
    assert profile.depth == 7
    assert profile.reliability is ReliabilityPolicy.RELIABLE
    assert profile.durability is DurabilityPolicy.VOLATILE
    assert profile.deadline == Duration()
    assert profile.avoid_ros_namespace_conventions is False


def test_unknown_settings_are_refused():
    with pytest.raises(AssertionError):
        QoSProfile(depth=1, colour="red")


def test_policies_are_set_by_value_and_checked():
    profile = QoSProfile(depth=1, reliability=2)
    assert profile.reliability is ReliabilityPolicy.BEST_EFFORT
    with pytest.raises(ValueError):
        profile.reliability = 99
    with pytest.raises(AssertionError):
        profile.reliability = "reliable"
    with pytest.raises(AssertionError):
        profile.deadline = 0.5


def test_equality():
    assert QoSProfile(depth=1) == QoSProfile(depth=1)
    assert QoSProfile(depth=1) != QoSProfile(depth=2)
    assert QoSProfile(depth=1) != QoSProfile(depth=1, deadline=Duration(seconds=1))


def test_presets():
    assert qos_profile_sensor_data.depth == 5
    assert qos_profile_sensor_data.reliability is ReliabilityPolicy.BEST_EFFORT
    assert qos_profile_services_default.depth == 10
    assert qos_profile_parameters.depth == 1000
    assert qos_profile_system_default.reliability is ReliabilityPolicy.SYSTEM_DEFAULT
    assert QoSPresetProfiles.SENSOR_DATA.value == qos_profile_sensor_data
    assert QoSPresetProfiles.get_from_short_key("sensor_data") == qos_profile_sensor_data


def test_short_keys():
    assert ReliabilityPolicy.get_from_short_key("best_effort") == ReliabilityPolicy.BEST_EFFORT
    assert type(ReliabilityPolicy.get_from_short_key("best_effort")) is int
    assert DurabilityPolicy.TRANSIENT_LOCAL.short_key == "transient_local"
    assert "keep_all" in HistoryPolicy.short_keys()
    assert LivelinessPolicy.get_from_short_key("automatic") == LivelinessPolicy.AUTOMATIC


@pytest.mark.parametrize(
    ("offered", "requested", "expected"),
    [
        ({}, {}, QoSCompatibility.OK),
        ({}, {"reliability": ReliabilityPolicy.BEST_EFFORT}, QoSCompatibility.OK),
        ({"reliability": ReliabilityPolicy.BEST_EFFORT}, {}, QoSCompatibility.ERROR),
        ({"durability": DurabilityPolicy.TRANSIENT_LOCAL}, {}, QoSCompatibility.OK),
        ({}, {"durability": DurabilityPolicy.TRANSIENT_LOCAL}, QoSCompatibility.ERROR),
        ({}, {"deadline": Duration(seconds=1)}, QoSCompatibility.ERROR),
        (
            {"deadline": Duration(seconds=2)},
            {"deadline": Duration(seconds=1)},
            QoSCompatibility.ERROR,
        ),
        ({"deadline": Duration(seconds=1)}, {"deadline": Duration(seconds=2)}, QoSCompatibility.OK),
        (
            {"liveliness": LivelinessPolicy.AUTOMATIC},
            {"liveliness": LivelinessPolicy.MANUAL_BY_TOPIC},
            QoSCompatibility.ERROR,
        ),
        (
            {"liveliness": LivelinessPolicy.MANUAL_BY_TOPIC},
            {"liveliness": LivelinessPolicy.AUTOMATIC},
            QoSCompatibility.OK,
        ),
        ({}, {"liveliness_lease_duration": Duration(seconds=1)}, QoSCompatibility.ERROR),
        (
            {"liveliness_lease_duration": Duration(seconds=2)},
            {"liveliness_lease_duration": Duration(seconds=1)},
            QoSCompatibility.ERROR,
        ),
        (
            {"liveliness_lease_duration": Duration(seconds=1)},
            {"liveliness_lease_duration": Duration(seconds=2)},
            QoSCompatibility.OK,
        ),
        ({"liveliness_lease_duration": Duration(seconds=1)}, {}, QoSCompatibility.OK),
        ({"deadline": Duration(seconds=1)}, {"deadline": Duration(seconds=1)}, QoSCompatibility.OK),
        ({"lifespan": Duration(seconds=2)}, {}, QoSCompatibility.OK),
        ({"reliability": ReliabilityPolicy.SYSTEM_DEFAULT}, {}, QoSCompatibility.WARNING),
        (
            {"durability": DurabilityPolicy.SYSTEM_DEFAULT},
            {"durability": DurabilityPolicy.TRANSIENT_LOCAL},
            QoSCompatibility.WARNING,
        ),
        (
            {"liveliness": LivelinessPolicy.SYSTEM_DEFAULT},
            {"liveliness": LivelinessPolicy.MANUAL_BY_TOPIC},
            QoSCompatibility.WARNING,
        ),
    ],
)
def test_compatibility(offered, requested, expected):
    plain = {"depth": 1, "liveliness": LivelinessPolicy.AUTOMATIC}
    compatibility, reason = qos_check_compatible(
        QoSProfile(**{**plain, **offered}), QoSProfile(**{**plain, **requested})
    )
    assert compatibility == expected
    assert bool(reason) == (expected != QoSCompatibility.OK)
    for name in requested if expected == QoSCompatibility.ERROR else ():
        assert name.split("_")[0] in reason.lower().replace("transient local", "durability")
