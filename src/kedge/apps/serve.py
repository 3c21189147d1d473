"""``kedge serve``: a simulated fleet, estimated as it drives."""

import socket

from kedge.core.errors import ConfigError, DataError

LOCAL = ("127.0.0.1", "localhost", "::1")


def execute(host: str, port: int, token: str | None, speed: float) -> None:
    """Simulate, then serve until interrupted.

    Raises:
        ConfigError: another host without a token, a port or speed of no use, or the extra
            ``live`` is not installed.
        DataError: the port is in use.
    """
    if host not in LOCAL and not token:
        raise ConfigError(f"--host {host}: others could read it, expected --token as well")
    if token == "":
        raise ConfigError("--token: found an empty one, expected some characters")
    if not 0 < port < 65536:
        raise ConfigError(f"--port: found {port}, expected 1 to 65535")
    if not 0.1 <= speed <= 100:
        raise ConfigError(f"--speed: found {speed:g}, expected 0.1 to 100")
    try:
        import uvicorn
        import websockets  # noqa: F401  (uvicorn needs it, and would say so too late)

        from kedge.live.web import application
    except ModuleNotFoundError as error:
        raise ConfigError(f"serve needs {error.name}: pip install 'kedge-nav[live]'") from None
    listening = _bound(host, port)
    from kedge.live.service import Service
    from kedge.live.simulated import fleet

    with listening:
        service = Service(fleet(progress=lambda text: print(text, flush=True)), speed)
        print(f"serving at http://{host}:{port} (end it with Ctrl-C)", flush=True)
        config = uvicorn.Config(
            application(service, token),
            log_level="warning",
            ws_max_size=65536,
            ws="websockets-sansio",
        )
        uvicorn.Server(config).run([listening])


def _bound(host: str, port: int) -> socket.socket:
    """A socket at the port, taken before anything is simulated.

    Raises:
        DataError: it cannot be had.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
        listening.listen()
    except OSError as error:
        listening.close()
        raise DataError(
            f"{host}:{port}: {error.strerror or error}; expected a free port, see --port"
        ) from None
    return listening
