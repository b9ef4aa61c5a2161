"""A session past its own gateways: programs of both ends joined directly, nothing on the link."""

from running_session import RunningSession


def test_with_bypass_all_streams_flow_and_the_link_carries_none_of_them(tmp_path):
    with RunningSession("spacejustin", "--bypass", directory=tmp_path) as session:
        session.wait_for_flow()
        assert session.select("static").returncode == 0
        code, report = session.interrupt()
    assert code == 0
    assert report["failures"] == []
    for name, stream in report["streams"].items():
        assert stream["frames_displayed"] > 0, name
    for link in report["link"].values():
        carried = {"haptic", "tmtc", "voice", "video", "rtcp"} & link["octets"].keys()
        assert [name for name in carried if link["octets"][name]] == []
