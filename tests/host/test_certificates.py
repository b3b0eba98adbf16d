"""`uoarm certificates` makes what machines need to join, and never a key that others may read."""

from __future__ import annotations

import ipaddress
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from uoarm._support.certificates import Authority
from uoarm.cli import main
from uoarm.errors import UsageError


def _read(folder: Path, name: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / f"{name}.pem").read_bytes())


def _usage(certificate: x509.Certificate) -> list[x509.ObjectIdentifier]:
    return list(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)


def test_one_command_makes_all(tmp_path: Path) -> None:
    folder = tmp_path / "made"
    words = ["--manager", "192.0.2.1", "--manager", "robot.local", "--machine", "left_arm"]
    done = CliRunner().invoke(main, ["certificates", *words, "--folder", str(folder)])
    assert done.exit_code == 0, done.output
    names = {path.name for path in folder.iterdir()}
    assert names == {f"{a}.{b}" for a in ("ca", "manager", "left_arm") for b in ("pem", "key")}
    assert folder.stat().st_mode & 0o077 == 0
    assert all(path.stat().st_mode & 0o777 == 0o600 for path in folder.glob("*.key"))


def test_a_manager_listens_and_a_machine_joins_and_neither_does_both(tmp_path: Path) -> None:
    authority = Authority.of(tmp_path)
    authority.certify_manager(["192.0.2.1", "robot.local"], 10)
    authority.certify_machine("arm", 10)
    manager, arm = _read(tmp_path, "manager"), _read(tmp_path, "arm")
    assert _usage(manager) == [ExtendedKeyUsageOID.SERVER_AUTH]
    assert _usage(arm) == [ExtendedKeyUsageOID.CLIENT_AUTH]
    (name,) = arm.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    assert name.value == "arm"
    names = manager.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.IPAddress) == [ipaddress.ip_address("192.0.2.1")]
    assert names.get_values_for_type(x509.DNSName) == ["robot.local"]
    for certificate in (manager, arm):
        certificate.verify_directly_issued_by(authority.certificate)


def test_the_authority_of_a_folder_stays(tmp_path: Path) -> None:
    first = Authority.of(tmp_path)
    Authority.of(tmp_path).certify_machine("arm", 10)
    _read(tmp_path, "arm").verify_directly_issued_by(first.certificate)


def test_a_certificate_is_not_overwritten(tmp_path: Path) -> None:
    Authority.of(tmp_path).certify_machine("arm", 10)
    before = (tmp_path / "arm.key").read_bytes()
    with pytest.raises(UsageError, match=r"arm\.pem is there already"):
        Authority.of(tmp_path).certify_machine("arm", 10)
    assert (tmp_path / "arm.key").read_bytes() == before


def test_a_key_without_its_certificate_is_not_overwritten(tmp_path: Path) -> None:
    Authority.of(tmp_path).certify_machine("arm", 10)
    (tmp_path / "arm.pem").unlink()
    with pytest.raises(UsageError, match=r"arm\.key is there already"):
        Authority.of(tmp_path).certify_machine("arm", 10)


def test_a_folder_that_is_gone_is_reported(tmp_path: Path) -> None:
    authority = Authority.of(tmp_path / "gone")
    shutil.rmtree(tmp_path / "gone")
    with pytest.raises(UsageError, match=r"arm\.pem cannot be made"):
        authority.certify_machine("arm", 10)


@pytest.mark.parametrize("address", ["", "münchen.local"])
def test_an_address_that_cannot_be_one_is_refused(tmp_path: Path, address: str) -> None:
    with pytest.raises(UsageError, match="cannot be reached at"):
        Authority.of(tmp_path).certify_manager([address], 10)


@pytest.mark.parametrize("name", ["", "ca", "manager", "../arm", "a/b", "7", "a*", "x" * 65, "ä"])
def test_a_name_that_no_machine_can_have_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="a machine cannot be called"):
        Authority.of(tmp_path).certify_machine(name, 10)


@pytest.mark.parametrize("text", ["", "no certificate", "-----BEGIN CERTIFICATE-----\nAA==\n"])
def test_an_authority_that_cannot_be_read_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "ca.pem").write_text(text)
    (tmp_path / "ca.key").write_text(text)
    with pytest.raises(UsageError, match="cannot hold certificates"):
        Authority.of(tmp_path)


def test_asked_for_nothing_it_says_what_to_ask_for() -> None:
    done = CliRunner().invoke(main, ["certificates"])
    assert done.exit_code == 2
    assert "--manager ADDRESS" in done.output
