import pytest

from linkrover.doctor import path, ros
from linkrover.doctor.finding import Status
from linkrover.probe.summary import summarise
from linkrover.records import ClockOffset, ProbeResult, ProbeState

OK, WARN, FAIL, UNKNOWN = Status.OK, Status.WARN, Status.FAIL, Status.UNKNOWN
MS = 1_000_000


@pytest.mark.parametrize(
    ("name", "status"), [("tsc", OK), ("arch_sys_counter", OK), ("hpet", WARN), ("jiffies", WARN), (None, UNKNOWN)]
)
def test_clock_sources(name, status):
    assert path.clock_source(name).status is status


def test_an_unsynchronised_clock_warns():
    assert path.synchronized(False, 16e9).status is WARN
    assert path.synchronized(True, 2e6).value == "yes, to within 2.0 ms by the kernel's own estimate"


@pytest.mark.parametrize(
    ("offset_ms", "bound_ms", "status"), [(3, 1, OK), (-60, 1, WARN), (15, 10, OK), (5000, 1, FAIL)]
)
def test_the_peers_clock_is_judged_beyond_its_bound(offset_ms, bound_ms, status):
    found = ClockOffset(wall_ns=0, mono_ns=0, peer="p", offset_ns=offset_ms * MS, error_bound_ns=bound_ms * MS)
    assert path.offset(found, "p").status is status
    assert path.offset(None, "p").status is UNKNOWN


def results(answered, lost, rtt_ms=5):
    out = []
    for n in range(answered + lost):
        t1 = 10**18 + n * 50 * MS
        times = {"t1_ns": t1, "t2_ns": t1 + rtt_ms * MS // 2, "t3_ns": t1 + rtt_ms * MS // 2, "t4_ns": t1 + rtt_ms * MS}
        fate = (
            {"state": ProbeState.ANSWERED, "rtt_ns": rtt_ms * MS, **times}
            if n < answered
            else {"state": ProbeState.LOST}
        )
        out.append(ProbeResult(wall_ns=t1, mono_ns=n * 50 * MS, peer="p", session=1, sequence=n + 1, **fate))
    return summarise(out)


@pytest.mark.parametrize(
    ("summary", "statuses"),
    [
        (results(40, 0), [OK, OK]), (results(38, 2), [WARN, OK]), (results(20, 20), [FAIL, OK]),
        (results(0, 40), [FAIL]),
        (results(40, 0, 80), [OK, WARN]), (results(40, 0, 300), [OK, FAIL]),
    ],
)  # fmt: skip
def test_loss_and_round_trip(summary, statuses):
    assert [f.status for f in path.answers(summary, "p", "start it")] == statuses


def test_large_messages_versions_and_bufferbloat():
    assert [path.large_messages(n, 5, 9000).status for n in (5, 4, 2, 0)] == [OK, OK, WARN, FAIL]
    assert path.version("0.1.0", "0.1.0", "p").status is OK
    assert path.version("0.1.0", "0.2.0", "p").status is WARN
    assert path.version("0.1.0", None, "p").status is UNKNOWN
    assert [path.bufferbloat(2 * MS, x * MS, "up").status for x in (10, 100, 400)] == [OK, WARN, FAIL]
    assert "+400 %" in path.bufferbloat(2 * MS, 10 * MS, "up").value
    assert path.bufferbloat(None, 1, "up").status is UNKNOWN


def environment(variables, *, peer=True, up=True, files=True):
    found = ros.environment(
        variables, peer=peer, local={"10.0.0.1"}, reachable=lambda host, port: up, exists=lambda name: files
    )
    return {f.check: f.status for f in found}


def test_without_ros_variables_all_is_well():
    assert environment({}) == {"ROS": OK}


@pytest.mark.parametrize(
    ("variables", "options", "check", "status"),
    [
        ({"ROS_MASTER_URI": "http://10.0.0.1:11311", "ROS_IP": "10.0.0.1"}, {}, "ROS 1 master", OK),
        ({"ROS_MASTER_URI": "http://10.0.0.1:11311"}, {"up": False}, "ROS 1 master", FAIL),
        ({"ROS_MASTER_URI": "http://localhost:11311"}, {}, "ROS 1 master", WARN),
        ({"ROS_MASTER_URI": "http://localhost:11311"}, {"peer": False}, "ROS 1 master", OK),
        ({"ROS_MASTER_URI": "10.0.0.1"}, {}, "ROS 1 master", FAIL),
        ({"ROS_MASTER_URI": "http://x:99999"}, {}, "ROS 1 master", FAIL),
        ({"ROS_VERSION": "1"}, {}, "ROS 1 master", WARN),
        ({"ROS_VERSION": "1"}, {}, "ROS 1 own address", WARN),
        ({"ROS_IP": "127.0.0.1"}, {}, "ROS 1 own address", FAIL),
        ({"ROS_IP": "10.9.9.9"}, {}, "ROS 1 own address", FAIL),
        ({"ROS_HOSTNAME": "robot"}, {}, "ROS 1 own address", OK),
        ({"ROS_VERSION": "2"}, {}, "ROS 2 domain", OK),
        ({"ROS_DOMAIN_ID": "150"}, {}, "ROS 2 domain", WARN),
        ({"ROS_DOMAIN_ID": "999"}, {}, "ROS 2 domain", FAIL),
        ({"ROS_DOMAIN_ID": "²"}, {}, "ROS 2 domain", FAIL),
        ({"ROS_LOCALHOST_ONLY": "1"}, {}, "ROS 2 discovery", FAIL),
        ({"ROS_LOCALHOST_ONLY": "1"}, {"peer": False}, "ROS 2 discovery", WARN),
        ({"ROS_LOCALHOST_ONLY": "0"}, {}, "ROS 2 discovery", OK),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {}, "ROS 2 discovery", FAIL),
        ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, {}, "ROS 2 middleware", OK),
        ({"CYCLONEDDS_URI": "file:///absent.xml"}, {"files": False}, "ROS 2 middleware", FAIL),
        ({"CYCLONEDDS_URI": "<CycloneDDS/>"}, {"files": False}, "ROS 2 middleware", OK),
    ],
)  # fmt: skip
def test_ros_variables(variables, options, check, status):
    assert environment(variables, **options)[check] is status
