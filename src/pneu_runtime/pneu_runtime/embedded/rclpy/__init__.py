# SPDX-License-Identifier: Apache-2.0
"""The rclpy API on a machine without ROS.

As in ROS 2 Jazzy: init, make nodes, spin, shut down. What is not there raises NotImplementedError
with the name of the call, or has no name to import.
"""

from types import TracebackType
from typing import TYPE_CHECKING

from rclpy.context import Context
from rclpy.signals import (
    SignalHandlerOptions,
    install_signal_handlers,
    uninstall_signal_handlers,
)
from rclpy.task import Future
from rclpy.utilities import (
    get_available_rmw_implementations,
    get_default_context,
    get_rmw_implementation_identifier,
    ok,
)
from rclpy.utilities import shutdown as _shutdown
from rclpy.utilities import try_shutdown as _try_shutdown

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node
    from rclpy.parameter import Parameter

__all__ = [
    "Context",
    "Future",
    "InitContextManager",
    "SignalHandlerOptions",
    "create_node",
    "get_available_rmw_implementations",
    "get_default_context",
    "get_global_executor",
    "get_rmw_implementation_identifier",
    "init",
    "ok",
    "shutdown",
    "spin",
    "spin_once",
    "spin_until_future_complete",
    "try_shutdown",
]

_executor: "Executor | None" = None


class InitContextManager:
    """What `init` returns: shuts down at the end of a ``with``.

    Jazzy's own `init` returns nothing; code that is to run there calls `try_shutdown` itself.

    Args:
        args: Command line.
        context: Context; the default one where None.
        domain_id: Domain of the graph.
        signal_handler_options: Which signals are handled.
    """

    def __init__(
        self,
        args: list[str] | None,
        context: Context | None,
        domain_id: int | None,
        signal_handler_options: SignalHandlerOptions | None,
    ) -> None:
        self.context = get_default_context() if context is None else context
        if signal_handler_options is None:
            # a context of one's own leaves the process's signals alone
            signal_handler_options = (
                SignalHandlerOptions.ALL if context is None else SignalHandlerOptions.NO
            )
            install = context is None
        else:
            install = True
        self.context.init(args, domain_id=domain_id)
        self.installed_signal_handlers = False
        if install:
            install_signal_handlers(signal_handler_options)
            self.installed_signal_handlers = True

    def __enter__(self) -> "InitContextManager":
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        _shut_executor()
        if self.context is get_default_context():
            _try_shutdown()
        else:
            self.context.try_shutdown()
        if self.installed_signal_handlers:
            uninstall_signal_handlers()


def init(
    *,
    args: list[str] | None = None,
    context: Context | None = None,
    domain_id: int | None = None,
    signal_handler_options: SignalHandlerOptions | None = None,
) -> InitContextManager:
    """Initialise a context, before nodes are made.

    Args:
        args: Command line, of which the part after ``--ros-args`` counts; that of the process
            where not given.
        context: Context; the default one where not given.
        domain_id: Domain of the graph; that of ROS_DOMAIN_ID where not given.
        signal_handler_options: Which signals shut contexts down: all for the default context, none
            for another one, where not given.

    Returns:
        InitContextManager: For a ``with``, at whose end the context is shut down.
    """
    return InitContextManager(args, context, domain_id, signal_handler_options)


def get_global_executor() -> "Executor":
    """Return the executor that `spin` uses where it is given none.

    Returns:
        Executor: A SingleThreadedExecutor.
    """
    global _executor
    if _executor is None or _executor._is_shutdown:
        from rclpy.executors import SingleThreadedExecutor

        # remade after a shutdown, which replaces the default context
        _executor = SingleThreadedExecutor()
    return _executor


def _shut_executor() -> None:
    global _executor
    if _executor is not None:
        _executor.shutdown()
        _executor = None


def shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    """Shut a context down.

    Args:
        context: Context; the default one where not given.
        uninstall_handlers: Whether signals are left alone from now on; where not given, that is
            so for the default context.
    """
    is_default = context is None or context is get_default_context()
    _shut_executor()
    _shutdown(context=context)
    if uninstall_handlers or (uninstall_handlers is None and is_default):
        uninstall_signal_handlers()


def try_shutdown(*, context: Context | None = None, uninstall_handlers: bool | None = None) -> None:
    """Shut a context down, unless that is done already.

    Args:
        context: Context; the default one where not given.
        uninstall_handlers: Whether signals are left alone from now on; where not given, that is
            so for the default context.
    """
    is_default = context is None or context is get_default_context()
    _shut_executor()
    _try_shutdown(context=context)
    if uninstall_handlers or (uninstall_handlers is None and is_default):
        uninstall_signal_handlers()


def create_node(
    node_name: str,
    *,
    context: Context | None = None,
    cli_args: list[str] | None = None,
    namespace: str | None = None,
    use_global_arguments: bool = True,
    enable_rosout: bool = True,
    start_parameter_services: bool = True,
    parameter_overrides: "list[Parameter] | None" = None,
    allow_undeclared_parameters: bool = False,
    automatically_declare_parameters_from_overrides: bool = False,
    enable_logger_service: bool = False,
) -> "Node":
    """Make a node.

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

    Returns:
        Node: The node.
    """
    from rclpy.node import Node

    return Node(
        node_name,
        context=context,
        cli_args=cli_args,
        namespace=namespace,
        use_global_arguments=use_global_arguments,
        enable_rosout=enable_rosout,
        start_parameter_services=start_parameter_services,
        parameter_overrides=parameter_overrides,
        allow_undeclared_parameters=allow_undeclared_parameters,
        automatically_declare_parameters_from_overrides=(
            automatically_declare_parameters_from_overrides
        ),
        enable_logger_service=enable_logger_service,
    )


def spin_once(
    node: "Node", *, executor: "Executor | None" = None, timeout_sec: float | None = None
) -> None:
    """Wait for one callback of a node and run it.

    Args:
        node: The node.
        executor: Executor; the global one where not given.
        timeout_sec: How long to wait at most [s]; None or negative for as long as it takes.
    """
    executor = get_global_executor() if executor is None else executor
    # a node that was there before, as within a callback of its own, stays there
    added = executor.add_node(node)
    try:
        executor.spin_once(timeout_sec=timeout_sec)
    finally:
        if added:
            executor.remove_node(node)


def spin(node: "Node", executor: "Executor | None" = None) -> None:
    """Run the callbacks of a node until its context is shut down.

    Args:
        node: The node.
        executor: Executor; the global one where not given.
    """
    executor = get_global_executor() if executor is None else executor
    # a node that was there before, as within a callback of its own, stays there
    added = executor.add_node(node)
    try:
        while executor.context.ok():
            executor.spin_once()
    finally:
        if added:
            executor.remove_node(node)


def spin_until_future_complete(
    node: "Node",
    future: Future,
    executor: "Executor | None" = None,
    timeout_sec: float | None = None,
) -> None:
    """Run the callbacks of a node until a future is done.

    Args:
        node: The node.
        future: The future.
        executor: Executor; the global one where not given.
        timeout_sec: How long at most [s]; None or negative for as long as it takes.
    """
    executor = get_global_executor() if executor is None else executor
    # a node that was there before, as within a callback of its own, stays there
    added = executor.add_node(node)
    try:
        executor.spin_until_future_complete(future, timeout_sec)
    finally:
        if added:
            executor.remove_node(node)
