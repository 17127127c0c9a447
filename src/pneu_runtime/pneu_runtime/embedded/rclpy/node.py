# SPDX-License-Identifier: Apache-2.0
"""Nodes: they own publishers, subscriptions, services, clients, timers and parameters."""

import weakref
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterEvent

from pneu_runtime import interfaces
from rclpy._arguments import RosArguments, parse_arguments
from rclpy._names import node_names
from rclpy._node_graph import GraphMixin
from rclpy._node_parameters import ParameterMixin
from rclpy._parameter_files import parameters_for
from rclpy._rclpy_pybind11 import InvalidHandle
from rclpy._rclpy_pybind11 import NodeNameNonExistentError as NodeNameNonExistentError
from rclpy._rosout import RosoutPublisher
from rclpy.callback_groups import (
    CallbackGroup,
    MutuallyExclusiveCallbackGroup,
    ReentrantCallbackGroup,
)
from rclpy.client import Client
from rclpy.clock import Clock, ROSClock
from rclpy.constants import S_TO_NS
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import NotInitializedException
from rclpy.executors import Executor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.logging import get_logger
from rclpy.logging_service import LoggingService
from rclpy.parameter import Parameter
from rclpy.parameter_service import ParameterService
from rclpy.publisher import Publisher
from rclpy.qos import (
    QoSProfile,
    qos_profile_parameter_events,
    qos_profile_services_default,
)
from rclpy.qos_overriding_options import QoSOverridingOptions, _declare_qos_parameters
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.time_source import TimeSource
from rclpy.timer import Rate, Timer
from rclpy.type_description_service import TypeDescriptionService
from rclpy.type_support import check_is_valid_msg_type, check_is_valid_srv_type
from rclpy.utilities import get_default_context
from rclpy.waitable import Waitable

MsgType = TypeVar("MsgType")


class Node(ParameterMixin, GraphMixin):
    """A node of the graph.

    Args:
        node_name: Name; a remapping ``__node:=`` replaces it.
        context: Context; the default one where not given.
        cli_args: Arguments for this node alone, in the form of a command line.
        namespace: Namespace; a remapping ``__ns:=`` replaces it.
        use_global_arguments: Whether the arguments given to init hold for this node.
        enable_rosout: Whether its log messages are published.
        start_parameter_services: Whether other nodes can see and set its parameters.
        parameter_overrides: Values that replace those with which parameters are declared.
        allow_undeclared_parameters: Whether parameters can be set without being declared.
        automatically_declare_parameters_from_overrides: Whether every override is declared.
        enable_logger_service: Whether other nodes can see and set its log levels.
    """

    def __init__(
        self,
        node_name: str,
        *,
        context: Context | None = None,
        cli_args: list[str] | None = None,
        namespace: str | None = None,
        use_global_arguments: bool = True,
        enable_rosout: bool = True,
        start_parameter_services: bool = True,
        parameter_overrides: list[Parameter] | None = None,
        allow_undeclared_parameters: bool = False,
        automatically_declare_parameters_from_overrides: bool = False,
        enable_logger_service: bool = False,
    ) -> None:
        self._context = get_default_context() if context is None else context
        self._publishers: list[Publisher[Any]] = []
        self._subscriptions: list[Subscription[Any]] = []
        self._clients: list[Client] = []
        self._services: list[Service] = []
        self._timers: list[Timer] = []
        self._guards: list[GuardCondition] = []
        self._waitables: list[Waitable] = []
        self._default_callback_group: CallbackGroup = MutuallyExclusiveCallbackGroup()
        self._rate_group = ReentrantCallbackGroup()
        self._executor_reference: weakref.ref[Executor] | None = None
        self._destroyed = True  # until there is something to destroy
        self._rosout: RosoutPublisher | None = None
        if not self._context.ok():
            raise NotInitializedException("cannot create node")

        local = RosArguments() if cli_args is None else parse_arguments(cli_args)
        common = self._context._arguments if use_global_arguments else RosArguments()
        self._names = node_names(node_name, namespace or "", (*local.remaps, *common.remaps))
        self._session = self._context._acquire_session()
        self._handle = self._session.add_node(self._names.namespace, self._names.name)
        self._destroyed = False
        # A node that is forgotten rather than destroyed leaves the graph as well.
        self._leave_graph = weakref.finalize(
            self, _leave_graph, self._context, self._session, self._handle
        )
        # the context closes the participant at the end of the process
        self._leave_graph.atexit = False

        self._logger = get_logger(self._names.logger_name)
        if enable_rosout and local.rosout_logs and common.rosout_logs:
            self._rosout = RosoutPublisher(self)
        self._parameter_event_publisher = self.create_publisher(
            ParameterEvent, "/parameter_events", qos_profile_parameter_events
        )
        given = parameters_for(common.parameters + local.parameters, self._names.full_name)
        overrides = {name: Parameter(name, value=value) for name, value in given.items()}
        overrides.update({one.name: one for one in parameter_overrides or ()})
        self._clock = ROSClock()
        self._init_parameters(
            overrides,
            allow_undeclared_parameters,
            automatically_declare_parameters_from_overrides,
        )
        self._time_source = TimeSource(node=self)
        self._time_source.attach_clock(self._clock)
        if start_parameter_services:
            self._parameter_service = ParameterService(self)
        if enable_logger_service:
            self._logger_service = LoggingService(self)
        self._type_description_service = TypeDescriptionService(self)
        self._context.track_node(self)

    # What it is

    @property
    def publishers(self) -> Iterator[Publisher[Any]]:
        """The publishers."""
        yield from list(self._publishers)

    @property
    def subscriptions(self) -> Iterator[Subscription[Any]]:
        """The subscriptions."""
        yield from list(self._subscriptions)

    @property
    def clients(self) -> Iterator[Client]:
        """The clients."""
        yield from list(self._clients)

    @property
    def services(self) -> Iterator[Service]:
        """The services."""
        yield from list(self._services)

    @property
    def timers(self) -> Iterator[Timer]:
        """The timers."""
        yield from list(self._timers)

    @property
    def guards(self) -> Iterator[GuardCondition]:
        """The guard conditions."""
        yield from list(self._guards)

    @property
    def waitables(self) -> Iterator[Waitable]:
        """The waitables."""
        yield from list(self._waitables)

    @property
    def executor(self) -> Executor | None:
        """The executor that runs its callbacks, if any."""
        return self._executor_reference() if self._executor_reference is not None else None

    @executor.setter
    def executor(self, new_executor: Executor | None) -> None:
        current = self.executor
        if current is new_executor:
            return
        if current is not None:
            current.remove_node(self)
        if new_executor is None:
            self._executor_reference = None
        else:
            self._executor_reference = weakref.ref(new_executor)
            new_executor.add_node(self)

    def _left_executor(self, executor: Executor) -> None:
        """Take note that an executor has removed this node."""
        if self.executor is executor:
            self._executor_reference = None

    def _wake_executor(self) -> None:
        executor = self.executor
        if executor is not None:
            executor._entities_changed()

    def _entities_with_sources(self) -> Iterator[Any]:
        """What an executor attaches to its waiter."""
        yield from list(self._subscriptions)
        yield from list(self._clients)
        yield from list(self._services)
        yield from [one for one in self._waitables if one._sources is not None]

    @property
    def context(self) -> Context:
        """The context."""
        return self._context

    @property
    def default_callback_group(self) -> CallbackGroup:
        """The callback group of entities that are given none: one callback at a time."""
        return self._default_callback_group

    @property
    def handle(self) -> Any:
        """The node in the transport."""
        return self._handle

    @handle.setter
    def handle(self, value: Any) -> None:
        raise AttributeError("handle cannot be modified after node creation")

    def _check(self) -> None:
        if self._destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")

    def get_name(self) -> str:
        """Return the name.

        Returns:
            str: The name, without the namespace.
        """
        self._check()
        return self._names.name

    def get_namespace(self) -> str:
        """Return the namespace.

        Returns:
            str: The namespace, absolute.
        """
        self._check()
        return self._names.namespace

    def get_fully_qualified_name(self) -> str:
        """Return the name with the namespace.

        Returns:
            str: The full name.
        """
        self._check()
        return self._names.full_name

    def get_clock(self) -> Clock:
        """Return the clock of the node.

        Returns:
            Clock: A ROSClock, which follows /clock where use_sim_time is set.
        """
        return self._clock

    def get_logger(self) -> RcutilsLogger:
        """Return the logger of the node.

        Returns:
            RcutilsLogger: The logger.
        """
        return self._logger

    def resolve_topic_name(self, topic: str, *, only_expand: bool = False) -> str:
        """Return the full name of a topic.

        Args:
            topic: The name as code gives it.
            only_expand: Whether remappings are left out.

        Returns:
            str: The full name.
        """
        self._check()
        return self._names.resolve(topic, only_expand=only_expand)

    def resolve_service_name(self, service: str, *, only_expand: bool = False) -> str:
        """Return the full name of a service.

        Args:
            service: The name as code gives it.
            only_expand: Whether remappings are left out.

        Returns:
            str: The full name.
        """
        self._check()
        return self._names.resolve(service, is_service=True, only_expand=only_expand)

    # Making entities

    def _validate_qos_or_depth_parameter(self, qos_or_depth: QoSProfile | int) -> QoSProfile:
        if isinstance(qos_or_depth, QoSProfile):
            return qos_or_depth
        if not isinstance(qos_or_depth, int):
            raise TypeError(f"Expected QoSProfile or int, but received {type(qos_or_depth)!r}")
        if qos_or_depth < 0:
            raise ValueError("history depth must be greater than or equal to zero")
        return QoSProfile(depth=qos_or_depth)

    def add_waitable(self, waitable: Waitable) -> None:
        """Have the executor wait for a waitable.

        Args:
            waitable: The waitable.
        """
        self._waitables.append(waitable)
        self._wake_executor()

    def remove_waitable(self, waitable: Waitable) -> None:
        """Take back `add_waitable`.

        Args:
            waitable: The waitable.
        """
        self._waitables.remove(waitable)
        for executor in list(waitable._holders):
            executor._forget(waitable)
        self._wake_executor()

    def _add(self, entity: Any, entities: list[Any], group: CallbackGroup | None) -> None:
        if group is not None:
            group.add_entity(entity)
        entities.append(entity)
        for handler in getattr(entity, "event_handlers", ()):
            self._waitables.append(handler)
        self._wake_executor()

    def create_publisher(
        self,
        msg_type: type[MsgType],
        topic: str,
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: PublisherEventCallbacks | None = None,
        qos_overriding_options: QoSOverridingOptions | None = None,
        publisher_class: type[Publisher[Any]] = Publisher,
    ) -> Publisher[MsgType]:
        """Make a publisher.

        Args:
            msg_type: Class of the messages.
            topic: Name of the topic.
            qos_profile: Quality of service, or the depth of the history alone.
            callback_group: Group of the event callbacks; the default one where not given.
            event_callbacks: What is called on events.
            qos_overriding_options: Which policies parameters may override.
            publisher_class: Class of the publisher.

        Returns:
            Publisher: The publisher.
        """
        self._check()
        profile = self._validate_qos_or_depth_parameter(qos_profile)
        group = callback_group or self._default_callback_group
        check_is_valid_msg_type(msg_type)
        full_name = self.resolve_topic_name(topic)
        profile = self._overridden(Publisher, full_name, profile, qos_overriding_options)
        end = self._session.create_publication(
            self._handle, full_name, interfaces.type_name(msg_type), profile
        )
        publisher = publisher_class(
            end, msg_type, topic, profile, event_callbacks or PublisherEventCallbacks(), group
        )
        publisher._bind(self._context, full_name, self._names.logger_name)
        self._add(publisher, self._publishers, None)
        return publisher

    def _overridden(
        self,
        kind: type,
        full_name: str,
        profile: QoSProfile,
        options: QoSOverridingOptions | None,
    ) -> QoSProfile:
        """The profile with what parameters say, where they may."""
        if options is None:
            return profile
        overridden = QoSProfile(
            **{name[1:]: getattr(profile, name) for name in QoSProfile.__slots__}
        )
        _declare_qos_parameters(kind, self, full_name, overridden, options)
        return overridden

    def create_subscription(
        self,
        msg_type: type[MsgType],
        topic: str,
        callback: Callable[..., Any],
        qos_profile: QoSProfile | int,
        *,
        callback_group: CallbackGroup | None = None,
        event_callbacks: SubscriptionEventCallbacks | None = None,
        qos_overriding_options: QoSOverridingOptions | None = None,
        raw: bool = False,
        content_filter_options: Any = None,
    ) -> Subscription[MsgType]:
        """Make a subscription.

        Args:
            msg_type: Class of the messages.
            topic: Name of the topic.
            callback: Called with the message, or with it and a `MessageInfo`.
            qos_profile: Quality of service, or the depth of the history alone.
            callback_group: Group of the callback; the default one where not given.
            event_callbacks: What is called on events.
            qos_overriding_options: Which policies parameters may override.
            raw: Whether the callback gets bytes instead of messages.
            content_filter_options: Refused; this runtime has no filters.

        Returns:
            Subscription: The subscription.
        """
        self._check()
        if content_filter_options is not None:
            raise NotImplementedError(
                "the embedded runtime has no Node.create_subscription with content_filter_options"
            )
        profile = self._validate_qos_or_depth_parameter(qos_profile)
        group = callback_group or self._default_callback_group
        check_is_valid_msg_type(msg_type)
        full_name = self.resolve_topic_name(topic)
        profile = self._overridden(Subscription, full_name, profile, qos_overriding_options)
        end = self._session.create_subscription(
            self._handle, full_name, interfaces.type_name(msg_type), profile
        )
        try:
            subscription = Subscription(
                end,
                msg_type,
                topic,
                callback,
                group,
                profile,
                raw,
                event_callbacks or SubscriptionEventCallbacks(),
            )
        except BaseException:
            end.close()
            raise
        subscription._bind(self._context, full_name, self._names.logger_name)
        self._add(subscription, self._subscriptions, group)
        return subscription

    def create_client(
        self,
        srv_type: Any,
        srv_name: str,
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Client:
        """Make a client of a service.

        Args:
            srv_type: Class of the service.
            srv_name: Name of the service.
            qos_profile: Quality of service.
            callback_group: Group in which responses are handled; the default one where not given.

        Returns:
            Client: The client.
        """
        self._check()
        group = callback_group or self._default_callback_group
        check_is_valid_srv_type(srv_type)
        full_name = self.resolve_service_name(srv_name)
        end = self._session.create_client(
            self._handle, full_name, interfaces.type_name(srv_type), qos_profile
        )
        client = Client(self._context, end, srv_type, srv_name, qos_profile, group)
        client._session = self._session
        client._bind(self._context, full_name, self._names.logger_name)
        self._add(client, self._clients, group)
        return client

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        qos_profile: QoSProfile = qos_profile_services_default,
        callback_group: CallbackGroup | None = None,
    ) -> Service:
        """Make a service.

        Args:
            srv_type: Class of the service.
            srv_name: Name of the service.
            callback: Called with the request and an empty response; returns the response.
            qos_profile: Quality of service.
            callback_group: Group of the callback; the default one where not given.

        Returns:
            Service: The service.
        """
        self._check()
        group = callback_group or self._default_callback_group
        check_is_valid_srv_type(srv_type)
        full_name = self.resolve_service_name(srv_name)
        end = self._session.create_server(
            self._handle, full_name, interfaces.type_name(srv_type), qos_profile
        )
        service = Service(end, srv_type, srv_name, callback, group, qos_profile)
        service._bind(self._context, full_name, self._names.logger_name)
        self._add(service, self._services, group)
        return service

    def create_timer(
        self,
        timer_period_sec: float,
        callback: Callable[..., Any] | None,
        callback_group: CallbackGroup | None = None,
        clock: Clock | None = None,
        autostart: bool = True,
    ) -> Timer:
        """Make a timer.

        Args:
            timer_period_sec: Period [s].
            callback: Called without arguments or with a `TimerInfo`.
            callback_group: Group of the callback; the default one where not given.
            clock: Clock; that of the node, which may run on simulated time, where not given.
            autostart: Whether it runs from the start.

        Returns:
            Timer: The timer.
        """
        self._check()
        group = callback_group or self._default_callback_group
        timer = Timer(
            callback,
            group,
            int(float(timer_period_sec) * S_TO_NS),
            self._clock if clock is None else clock,
            context=self._context,
            autostart=autostart,
        )
        self._add(timer, self._timers, group)
        return timer

    def create_guard_condition(
        self, callback: Callable[[], Any], callback_group: CallbackGroup | None = None
    ) -> GuardCondition:
        """Make a guard condition.

        Args:
            callback: Called after a trigger.
            callback_group: Group of the callback; the default one where not given.

        Returns:
            GuardCondition: The guard condition.
        """
        self._check()
        group = callback_group or self._default_callback_group
        guard = GuardCondition(callback, group, context=self._context)
        self._add(guard, self._guards, group)
        return guard

    def create_rate(self, frequency: float, clock: Clock | None = None) -> Rate:
        """Make a rate to sleep by, in a thread that does not spin.

        Args:
            frequency: Frequency [Hz].
            clock: Clock; that of the node where not given.

        Returns:
            Rate: The rate.
        """
        if frequency <= 0:
            raise ValueError("frequency must be > 0")
        timer = self.create_timer(1.0 / frequency, None, self._rate_group, clock)
        return Rate(timer, context=self._context)

    # Destroying them

    def _remove(self, entity: Any, entities: list[Any]) -> bool:
        if entity not in entities:
            return False
        entities.remove(entity)
        for handler in getattr(entity, "event_handlers", ()):
            if handler in self._waitables:
                self._waitables.remove(handler)
        try:
            entity.destroy()
        except InvalidHandle:
            return False
        self._wake_executor()
        return True

    def destroy_publisher(self, publisher: Publisher[Any]) -> bool:
        """Destroy a publisher.

        Args:
            publisher: The publisher.

        Returns:
            bool: Whether it was one of this node.
        """
        return self._remove(publisher, self._publishers)

    def destroy_subscription(self, subscription: Subscription[Any]) -> bool:
        """Destroy a subscription.

        Args:
            subscription: The subscription.

        Returns:
            bool: Whether it was one of this node.
        """
        return self._remove(subscription, self._subscriptions)

    def destroy_client(self, client: Client) -> bool:
        """Destroy a client.

        Args:
            client: The client.

        Returns:
            bool: Whether it was one of this node.
        """
        return self._remove(client, self._clients)

    def destroy_service(self, service: Service) -> bool:
        """Destroy a service.

        Args:
            service: The service.

        Returns:
            bool: Whether it was one of this node.
        """
        return self._remove(service, self._services)

    def destroy_timer(self, timer: Timer) -> bool:
        """Destroy a timer.

        Args:
            timer: The timer.

        Returns:
            bool: Whether it was one of this node.
        """
        return self._remove(timer, self._timers)

    def destroy_guard_condition(self, guard: GuardCondition) -> bool:
        """Destroy a guard condition.

        Args:
            guard: The guard condition.

        Returns:
            bool: Whether it was one of this node.
        """
        return self._remove(guard, self._guards)

    def destroy_rate(self, rate: Rate) -> bool:
        """Destroy a rate.

        Args:
            rate: The rate.

        Returns:
            bool: Whether it was one of this node.
        """
        rate.destroy()
        return self.destroy_timer(rate._timer)

    def destroy_node(self) -> None:
        """Destroy the node and all that it owns. A second call does nothing."""
        if self._destroyed:
            return
        self._context.untrack_node(self)
        executor = self.executor
        if executor is not None:
            executor.remove_node(self)
        for entities in (
            self._publishers,
            self._subscriptions,
            self._clients,
            self._services,
            self._timers,
            self._guards,
        ):
            for entity in list(entities):
                self._remove(entity, entities)
        for waitable in list(self._waitables):
            self.remove_waitable(waitable)
        if self._rosout is not None:
            self._rosout.destroy()
        self._destroyed = True
        self._leave_graph()

    def __enter__(self) -> "Node":
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        self.destroy_node()


def _leave_graph(context: Context, session: Any, handle: Any) -> None:
    """Take a node out of the graph, and with the last one the participant."""
    session.remove_node(handle)
    context._release_session()
