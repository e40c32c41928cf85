"""The page on a network: over TLS alone, for devices with a token, each of which can be revoked."""

import datetime
import http.client
import ipaddress
import json
import select
import socket
import ssl
import time
from contextlib import ExitStack, closing
from pathlib import Path
from urllib.parse import urlencode, urlsplit

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from typer.testing import CliRunner

from pipeline.batch.layout import Results
from pipeline.cli import app
from pipeline.problem import BatchRefused
from pipeline.watch import device_login
from pipeline.watch.connections import BACKLOG, TURNS, connections_at_once
from pipeline.watch.device_login import MOST_WRONG, WRONG_S, network_of
from pipeline.watch.devices import add_device, read_devices, revoke_device
from pipeline.watch.page_server import PageServer

NOW = datetime.datetime(2026, 8, 14, 9, 30, tzinfo=datetime.UTC)


def certificate_of(folder, name="page", *, password=None):
    """A certificate for 127.0.0.1 and its key, by another library than the server's."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    place = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    today = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(subject).issuer_name(subject).public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(today).not_valid_after(today + datetime.timedelta(days=1))
        .add_extension(place, critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )  # fmt: skip
    locked = serialization.BestAvailableEncryption(password) if password else serialization.NoEncryption()
    pem = serialization.Encoding.PEM
    paths = folder / f"{name}.pem", folder / f"{name}-key.pem"
    paths[0].write_bytes(made.public_bytes(pem))
    paths[1].write_bytes(key.private_bytes(pem, serialization.PrivateFormat.PKCS8, locked))
    return paths


@pytest.fixture
def devices(tmp_path):
    return tmp_path / "devices.json"


@pytest.fixture
def time_s(monkeypatch):
    """The clock of the login, which a test may move."""
    now = [1000.0]
    made = device_login.DeviceLogin.__init__
    monkeypatch.setattr(
        device_login.DeviceLogin, "__init__", lambda self, **how: made(self, clock=lambda: now[0], **how)
    )
    return now


@pytest.fixture
def server(tmp_path, devices, time_s):
    token = add_device(devices, "belt 2", now=NOW)
    certificate, key = certificate_of(tmp_path)
    network = network_of("0.0.0.0", certificate=certificate, key=key, devices=devices)
    with PageServer(Results(tmp_path / "results"), network=network) as serving:
        serving.show("<p>page</p>")
        serving.token, serving.trusted = token, certificate
        yield serving


def ask(server, path, form=None, **headers):
    """Status, headers and text of one answer, by a client that checks the certificate."""
    port = urlsplit(server.address).port
    context = ssl.create_default_context(cafile=server.trusted)
    with closing(http.client.HTTPSConnection("127.0.0.1", port, context=context, timeout=10)) as connection:
        names = {name.replace("_", "-"): text for name, text in headers.items()}
        body = None if form is None else urlencode(form)
        connection.request("GET" if form is None else "POST", path, body=body, headers=names)
        with connection.getresponse() as answer:
            return answer.status, dict(answer.getheaders()), answer.read().decode()


def login(server, token, **headers):
    return ask(server, "/login", {"token": token}, **({"Sec_Fetch_Site": "same-origin"} | headers))


def session(server):
    """The cookie of a device that has logged in."""
    return login(server, server.token)[1]["set-cookie"].partition(";")[0]


def test_a_device_sees_the_page_after_it_sent_its_token(server):
    status, headers, body = ask(server, "/")
    assert (status, headers["location"], body) == (303, "login", "")
    assert 'type="password"' in ask(server, "/login")[2]
    status, headers, _ = login(server, server.token)
    assert (status, headers["location"]) == (303, "./")
    attributes = {attribute.strip().lower() for attribute in headers["set-cookie"].split(";")[1:]}
    assert {"secure", "httponly", "samesite=strict", "path=/"} < attributes
    cookie = headers["set-cookie"].partition(";")[0]
    assert server.token not in cookie
    assert ask(server, "/", Cookie=cookie)[::2] == (200, "<p>page</p>")
    assert ask(server, "/", Cookie=cookie[:-1])[0] == 303
    for path in ("/events", "/judge?fruit=N1", "/scan?code=N1", "/report.html", "/devices.json"):
        assert ask(server, path)[0] == 404


def test_without_tls_there_is_nothing(server):
    port = urlsplit(server.address).port
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as connection:
        connection.request("GET", "/login")
        with pytest.raises((http.client.HTTPException, OSError)):
            connection.getresponse()


def test_connections_that_begin_no_tls_leave_files_to_grading(server):
    """They are closed beyond the limit, at once; the others after the time for a handshake."""
    most = connections_at_once() + TURNS * BACKLOG
    with ExitStack() as held:
        place = "127.0.0.1", urlsplit(server.address).port
        idle = [held.enter_context(socket.create_connection(place, timeout=10)) for _ in range(most + 100)]
        time.sleep(1)
        closed, _, _ = select.select(idle, [], [], 0)
        assert 100 <= len(closed) <= 110
    assert ask(server, "/login")[0] == 200


def test_a_revoked_device_loses_its_session_and_its_token_at_once(server, devices):
    cookie = session(server)
    other = add_device(devices, "office", now=NOW)
    assert ask(server, "/", Cookie=cookie)[0] == 200
    revoke_device(devices, "belt 2")
    assert ask(server, "/", Cookie=cookie)[0] == 303
    assert login(server, server.token)[0] == 401
    assert login(server, other)[0] == 303
    devices.unlink()
    assert login(server, other)[0] == 401


def test_wrong_tokens_make_an_address_wait(server, time_s):
    for _ in range(MOST_WRONG):
        assert login(server, "wrong")[0] == 401
    status, headers, page = login(server, server.token)
    assert status == 429
    assert 0 < int(headers["retry-after"]) <= WRONG_S + 1
    assert "too many wrong tokens" in page
    time_s[0] += WRONG_S + 1
    assert login(server, server.token)[0] == 303


def test_a_session_ends_after_its_time(server, time_s):
    cookie = session(server)
    time_s[0] += device_login.SESSION_S + 1
    assert ask(server, "/", Cookie=cookie)[0] == 303


@pytest.mark.parametrize(
    "headers",
    [{"Sec_Fetch_Site": "cross-site"}, {"Sec_Fetch_Site": "same-site"}, {"Sec_Fetch_Site": "none"}],
)
def test_a_token_from_another_page_is_not_taken(server, headers):
    assert login(server, server.token, **headers)[0] == 403


@pytest.mark.parametrize(
    ("origin", "status"),
    [("https://{}", 303), ("http://{}", 403), ("https://evil.example", 403), (None, 403)],
)
def test_an_older_browser_must_name_the_page_as_origin(server, origin, status):
    host = f"127.0.0.1:{urlsplit(server.address).port}"
    headers = {} if origin is None else {"Origin": origin.format(host)}
    assert ask(server, "/login", {"token": server.token}, **headers)[0] == status


def test_the_file_of_devices_has_no_token_and_is_its_owner_s(devices):
    said = CliRunner().invoke(app, ["device", "add", str(devices), "belt 2"])
    token = said.stdout.strip()
    assert len(token) >= 43
    assert token not in devices.read_text()
    assert devices.stat().st_mode & 0o777 == 0o600
    assert set(json.loads(devices.read_text())["devices"][0]) == {"name", "sha256", "added_utc"}
    assert CliRunner().invoke(app, ["device", "list", str(devices)]).stdout.endswith("  belt 2\n")
    with pytest.raises(BatchRefused, match="has a token already"):
        add_device(devices, "belt 2", now=NOW)
    with pytest.raises(BatchRefused, match='did you mean "belt 2"'):
        revoke_device(devices, "bellt 2")
    assert CliRunner().invoke(app, ["device", "revoke", str(devices), "belt 2"]).exit_code == 0
    assert read_devices(devices) == ()


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1"])
def test_this_machine_alone_is_the_default_and_needs_no_certificate(host):
    assert network_of(host, certificate=None, key=None, devices=None) is None


def test_a_network_without_certificate_key_or_devices_is_refused(tmp_path, devices):
    def why(host="0.0.0.0", **given):
        options = {"certificate": None, "key": None, "devices": None} | given
        with pytest.raises(BatchRefused) as refusal:
            network_of(host, **options)
        return str(refusal.value)

    assert "--host 192.168.1.5: needs --certificate and --key and --devices" in why("192.168.1.5")
    assert "needs --devices" in why(certificate=Path("a"), key=Path("b"))
    certificate, key = certificate_of(tmp_path)
    _, other = certificate_of(tmp_path, "other")
    locked = certificate_of(tmp_path, "locked", password=b"secret")
    assert "there is no file" in why(certificate=tmp_path / "none.pem", key=key, devices=devices)
    assert "cannot be used" in why(certificate=certificate, key=other, devices=devices)
    assert "without a password" in why(certificate=locked[0], key=locked[1], devices=devices)
    assert "drupe device add" in why(certificate=certificate, key=key, devices=devices)
    devices.write_text("[]")
    assert "is no file of devices" in why(certificate=certificate, key=key, devices=devices)
