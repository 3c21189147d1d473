import contextlib
import json
import socket
import struct
import threading
import time
import urllib.error
import urllib.request

import pytest

from kedge.live.service import Service
from kedge.live.simulated import FLEET, Fleet, drive

uvicorn = pytest.importorskip("uvicorn")
client = pytest.importorskip("websockets.sync.client")
pytestmark = pytest.mark.slow  # a drive is simulated first


@contextlib.contextmanager
def served(fleet, token=None):
    from kedge.live.web import application

    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        app = application(Service(fleet, speed=5.0), token)
        server = uvicorn.Server(uvicorn.Config(app, log_level="error", ws="websockets-sansio"))
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        until = time.monotonic() + 10
        while not server.started:
            assert thread.is_alive()
            assert time.monotonic() < until
            time.sleep(0.02)
        try:
            yield f"127.0.0.1:{listening.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join()


@pytest.fixture(scope="module")
def carrier():
    plan = FLEET[0]
    return drive(plan._replace(overrides=plan.overrides | {"scenario.duration": "40.0"}))


def get(address, path):
    try:
        with urllib.request.urlopen(f"http://{address}{path}") as answer:
            return answer.status, json.load(answer)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)


def test_a_page_gets_frames_and_its_faults_are_obeyed(carrier):
    with served(Fleet([carrier])) as address:
        with client.connect(f"ws://{address}/v1/page") as page:
            first, second = (struct.unpack_from("<I", page.recv(5), 24)[0] for _ in range(2))
            assert second == first + 1
            page.send(json.dumps({"fault": {"vehicle": 0, "kind": "nan", "seconds": 60}}))
            until = time.monotonic() + 5
            while b'"kind":"nan"' not in page.recv(5):
                assert time.monotonic() < until
            page.send("{")
            while not isinstance(answer := page.recv(5), str):
                assert time.monotonic() < until
            assert "not JSON" in json.loads(answer)["error"]
        assert get(address, "/ready") == (200, {"ready": True})
        code, health = get(address, "/health")
        assert code == 200
        assert set(health["vehicles"]) == {"carrier 1"}
        assert get(address, "/v1/describe")[1]["vehicles"][0]["name"] == "carrier 1"


def test_without_its_token_nothing_is_served(carrier):
    with served(Fleet([carrier]), "secret") as address:
        assert get(address, "/v1/describe")[0] == 401
        assert get(address, "/v1/describe?token=secreT")[0] == 401
        assert get(address, "/v1/describe?token=secret")[0] == 200
        with pytest.raises(Exception, match="403"), client.connect(f"ws://{address}/v1/page"):
            pass
        with client.connect(f"ws://{address}/v1/page?token=secret") as page:
            assert isinstance(page.recv(5), bytes)
        url = f"ws://{address}/v1/page?token=secret"
        with (
            pytest.raises(Exception, match="403"),
            client.connect(url, origin="http://else.org"),
        ):
            pass
