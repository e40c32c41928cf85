"""The page on a network: over TLS alone, for devices with a token that can be revoked."""

import datetime
import http.client
import ipaddress
import json
import select
import socket
import ssl
import subprocess
import sys
import time
from contextlib import ExitStack, closing, nullcontext, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from browser import chromium
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from page_client import answer_to
from typer.testing import CliRunner

from pipeline.batch.layout import Results, write_whole
from pipeline.cli import app
from pipeline.problem import BatchRefused
from pipeline.watch import device_login
from pipeline.watch import devices as device_file
from pipeline.watch.device_login import network_of
from pipeline.watch.devices import add_device, read_devices, revoke_device
from pipeline.watch.page_server import MOST_CONNECTIONS, MOST_OF_ADDRESS, PageServer
from reports.kiosk_page import KioskEntry, kiosk_html

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="other systems have one loopback address")
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


class Desk:
    """Knows every fruit, and keeps what it is told."""

    def __init__(self):
        self.kept = []

    def form(self, fruit_id):
        return f"form of {fruit_id}"

    def scanned(self, text):
        return f"judge?fruit={text}", ""

    def judge(self, *verdict):
        self.kept.append(verdict)


@pytest.fixture
def server(tmp_path, devices, time_s):
    token = add_device(devices, "belt 2", now=NOW)
    certificate, key = certificate_of(tmp_path)
    network = network_of("0.0.0.0", certificate=certificate, key=key, devices=devices)
    results, messages = Results(tmp_path / "results"), []
    results.claim()
    write_whole(results.report, "report")
    with PageServer(results, network=network, tell=messages.append) as serving:
        serving.show("<p>page</p>")
        serving.desk = Desk()
        serving.token, serving.trusted, serving.messages = token, certificate, messages
        yield serving


def connected(server, *, address="127.0.0.1"):
    """A connection from an address of this machine, by a client that checks the certificate."""
    context = ssl.create_default_context(cafile=server.trusted)
    port = urlsplit(server.address).port
    return closing(
        http.client.HTTPSConnection(
            "127.0.0.1", port, context=context, timeout=10, source_address=(address, 0)
        )
    )


def ask(server, path, form=None, **how):
    return answer_to(connected(server), path, form, **how)


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


@pytest.mark.parametrize(
    ("path", "status", "text"),
    [("/judge?fruit=N1", 200, "form of N1"), ("/scan?code=N1", 303, ""), ("/report.html", 200, "report")],
)
def test_every_address_asks_for_the_session(server, path, status, text):
    assert ask(server, path, Cookie=session(server))[::2] == (status, text)
    assert ask(server, path)[::2] == (404, "not found")


def test_a_verdict_needs_the_session_and_the_page_s_own_form(server):
    cookie, form = session(server), {"class": "firm"}
    path, kept = "/judge?fruit=N1", server.desk.kept
    assert ask(server, path, form, Sec_Fetch_Site="same-origin")[0] == 404
    assert ask(server, path, form, Sec_Fetch_Site="cross-site", Cookie=cookie)[0] == 404
    assert ask(server, path, form, Cookie=cookie)[0] == 404
    assert kept == []
    assert ask(server, path, form, Sec_Fetch_Site="same-origin", Cookie=cookie)[0] == 303
    assert kept == [("N1", form, "belt 2")]


def test_news_need_the_session_and_end_when_the_device_is_revoked(server, devices):
    assert ask(server, "/events")[0] == 404
    with connected(server) as connection:
        connection.request("GET", "/events", headers={"Cookie": session(server)})
        with connection.getresponse() as answer:
            assert (answer.status, answer.readline()) == (200, b"event: changed\n")
            revoke_device(devices, "belt 2")
            began = time.monotonic()
            answer.read()
            assert time.monotonic() - began < 5


def test_a_device_ends_its_own_session(server):
    cookie, other = session(server), session(server)
    assert ask(server, "/logout", {}, Sec_Fetch_Site="cross-site", Cookie=cookie)[0] == 403
    assert ask(server, "/", Cookie=cookie)[0] == 200
    status, headers, _ = ask(server, "/logout", {}, Sec_Fetch_Site="same-origin", Cookie=cookie)
    assert (status, headers["location"]) == (303, "login")
    assert ask(server, "/", Cookie=cookie)[0] == 303
    assert ask(server, "/", Cookie=other)[0] == 200


def test_two_pages_of_one_machine_keep_both_sessions(server, tmp_path):
    """Browsers send a host's cookies to all of its ports, and keep one of each name."""
    with PageServer(Results(tmp_path / "other"), network=server._network) as second:
        second.token, second.trusted = server.token, server.trusted
        kept = dict(session(each).split("=") for each in (server, second))
        cookies = "; ".join(f"{name}={text}" for name, text in kept.items())
        assert [ask(each, "/", Cookie=cookies)[0] for each in (server, second)] == [200, 200]


def test_without_tls_there_is_nothing(server):
    port = urlsplit(server.address).port
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as connection:
        connection.request("GET", "/login")
        with pytest.raises((http.client.HTTPException, OSError)):
            connection.getresponse()


@on_linux
def test_one_address_has_its_share_of_connections_and_leaves_files_to_grading(server):
    """Its forms that never end occupy the page; connections of others that begin no TLS are closed."""
    cookie, begun, place = session(server), 0, ("127.0.0.1", urlsplit(server.address).port)
    with ExitStack() as held:
        for _ in range(2 * MOST_OF_ADDRESS):
            with suppress(OSError):
                connection = held.enter_context(connected(server, address="127.0.1.1"))
                connection.putrequest("POST", "/login")
                connection.putheader("Sec-Fetch-Site", "same-origin")
                connection.putheader("Content-Length", "100")
                connection.endheaders()
                begun += 1
        assert begun == MOST_OF_ADDRESS
        assert ask(server, "/", Cookie=cookie)[0] == 200
        idle = [
            held.enter_context(socket.create_connection(place, 10, (f"127.0.2.{1 + k % 50}", 0)))
            for k in range(MOST_CONNECTIONS + 50)
        ]
        closed, until = [], time.monotonic() + 5
        while len(closed) < 50 and time.monotonic() < until:
            closed, _, _ = select.select(idle, [], [], 0.01)
        assert 50 <= len(closed) <= 50 + MOST_OF_ADDRESS


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


def test_no_device_is_known_while_their_file_cannot_be_read(server, devices):
    cookie, text = session(server), devices.read_text()
    for broken in ("[]", text.replace('"sha256": "', '"sha256": "é')):
        devices.write_text(broken)
        assert ask(server, "/", Cookie=cookie)[0] == 303
        assert login(server, server.token)[0] == 401
    devices.write_text(text)
    assert login(server, server.token)[0] == 303


@pytest.mark.parametrize(
    ("path", "method", "status"), [("/", "PUT", 405), ("/", "GET", 303), ("/none", "GET", 404)]
)
def test_every_answer_has_the_headers(server, path, method, status):
    answered, headers, _ = ask(server, path, method=method)
    assert answered == status
    assert {"x-frame-options": "DENY", "cache-control": "no-store"}.items() <= headers.items()


def test_no_suite_without_encryption_or_certificate_is_offered(server):
    """uvicorn 0.40 has suites of its own where it is given none."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.set_ciphers(server._server.config.ssl_ciphers)
    for offered in (context.get_ciphers(), server._server.config.ssl.get_ciphers()):
        assert {"TLS_AES_256_GCM_SHA384", "ECDHE-ECDSA-AES256-GCM-SHA384"} < {
            suite["name"] for suite in offered
        }
        assert all(suite["auth"] != "auth-null" and suite["strength_bits"] >= 128 for suite in offered)


@pytest.mark.parametrize(
    "headers", [{"Sec_Fetch_Site": "cross-site"}, {"Sec_Fetch_Site": "same-site"}, {"Sec_Fetch_Site": "none"}]
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


ADDING = """
import datetime, pathlib, sys
from pipeline.watch.devices import add_device
add_device(pathlib.Path(sys.argv[1]), sys.argv[2], now=datetime.datetime.now(datetime.UTC))
"""


def test_devices_that_are_added_at_once_are_all_kept(devices):
    running = [subprocess.Popen([sys.executable, "-c", ADDING, devices, f"belt {k}"]) for k in range(8)]
    assert [each.wait(60) for each in running] == 8 * [0]
    assert {device.name for device in read_devices(devices)} == {f"belt {k}" for k in range(8)}


def test_a_file_that_another_process_keeps_is_waited_for_no_longer(devices, monkeypatch):
    monkeypatch.setattr(device_file, "lock_of", lambda _: nullcontext(False))
    with pytest.raises(BatchRefused, match=r"another process holds"):
        add_device(devices, "belt 2", now=NOW)
    assert not devices.exists()


def test_a_file_of_devices_keeps_its_mode_and_its_owner_where_root_changes_it(devices, monkeypatch):
    add_device(devices, "belt 2", now=NOW)
    devices.chmod(0o640)
    owners = []
    monkeypatch.setattr("os.geteuid", lambda: 0)
    monkeypatch.setattr("os.chown", lambda _, user, group: owners.append((user, group)))
    add_device(devices, "office", now=NOW)
    assert devices.stat().st_mode & 0o777 == 0o640
    assert owners == [(devices.stat().st_uid, devices.stat().st_gid)]


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_this_machine_alone_is_the_default_and_needs_no_certificate(host):
    assert network_of(host, certificate=None, key=None, devices=None) is None


def test_a_network_without_certificate_key_or_devices_is_refused(tmp_path, devices):
    def why(host="0.0.0.0", **given):
        options = {"certificate": None, "key": None, "devices": None} | given
        with pytest.raises(BatchRefused) as refusal:
            network_of(host, **options)
        return str(refusal.value)

    assert "--host 192.168.1.5: needs --certificate and --key and --devices" in why("192.168.1.5")
    for host in ("::1", "127.0.0.2"):
        assert f"--host {host}: needs --certificate" in why(host)
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


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


def page_address(server):
    return f"https://127.0.0.1:{urlsplit(server.address).port}/"


@pytest.fixture
def page(browser, server):
    """A page of Chromium after the login's form was sent; `forms` are those that it sent."""
    server.show(kiosk_html(KioskEntry(name="monday"), logout=True))
    opened, forms = browser.new_page(ignore_https_errors=True), []
    opened.on("request", lambda request: request.method == "POST" and forms.append(request))
    opened.goto(page_address(server))
    opened.fill("input[name=token]", server.token)
    opened.click("button")
    opened.forms = forms
    yield opened
    opened.close()


def test_chromium_s_forms_are_of_the_page_for_browsers_that_name_the_origin_alone(page, server):
    """The policy of the referrer decides about the origin that a form has."""
    page.wait_for_url("**/")
    origin = page.forms[0].all_headers()["origin"]
    assert ask(server, "/login", {"token": server.token}, Origin=origin)[0] == 303


@pytest.mark.parametrize("ends", ["revoked", "expired"])
def test_a_page_whose_session_ends_shows_the_login(page, devices, time_s, ends):
    page.wait_for_selector("#board")
    if ends == "revoked":
        revoke_device(devices, "belt 2")
    else:
        time_s[0] += device_login.SESSION_S + 1
    page.wait_for_url("**/login", timeout=10_000)
    assert page.locator("input[name=token]").get_attribute("autocomplete") == "off"


def test_a_device_logs_out_by_a_button(page, server):
    page.get_by_role("button", name="Log out").click()
    page.wait_for_url("**/login")
    page.goto(page_address(server))
    assert page.url.endswith("/login")
