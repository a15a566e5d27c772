from linkrover.probe import limits
from linkrover.probe.limits import Bucket, Session, SessionTable, SourceLimiter

S = 1_000_000_000


def test_a_bucket_gives_its_burst_then_its_rate():
    bucket = Bucket(10.0, 5.0, 0)
    assert sum(bucket.take(0) for _ in range(20)) == 5
    assert sum(bucket.take(S) for _ in range(20)) == 5, "never more than the burst is saved up"
    assert sum(bucket.take(S + k * S // 100) for k in range(1, 101)) in (9, 10)


def test_one_greedy_source_does_not_starve_another():
    limiter = SourceLimiter(100.0, 50.0, 10_000.0, 0)
    assert sum(limiter.allows("10.0.0.1", 0) for _ in range(1000)) == 50
    assert limiter.allows("10.0.0.2", 0)


def test_addresses_of_one_ipv6_64_share_a_bucket():
    limiter = SourceLimiter(100.0, 50.0, 10_000.0, 0)
    assert sum(limiter.allows(f"2001:db8::{k:x}", 0) for k in range(1, 1000)) == 50
    assert limiter.allows("2001:db8:0:1::1", 0)
    assert limiter.allows("fe80::1%eth0", 0)


def test_a_flood_from_invented_sources_is_bounded_in_memory_and_in_rate():
    limiter = SourceLimiter(100.0, 50.0, 1_000.0, 0)
    allowed = sum(limiter.allows(f"10.{k >> 16}.{k >> 8 & 255}.{k & 255}", 0) for k in range(20_000))
    assert allowed == 500
    assert len(limiter) <= limits.SOURCES_MOST


def test_a_flood_of_invented_sessions_does_not_push_out_one_that_is_measured():
    table = SessionTable(100)
    key = ("10.0.0.1", 5000, 7)
    for k in range(20):
        session = table.get(key, k * S // 5)
        session.note(k, k * S // 5)
        session.sequence += 1
    for k in range(10_000):
        table.get((f"10.9.{k >> 8}.{k & 255}", 1, 1), 4 * S).note(0, 4 * S)
    assert len(table) <= 100
    assert table.get(key, 5 * S).sequence == 20
    assert table.evicted > 9_000


def test_idle_sessions_expire_and_a_full_table_prefers_the_living():
    table = SessionTable(4)
    for host in ("a", "b"):
        for k in range(12):
            table.get((host, 1, 1), k * S).note(k, k * S)
    assert set(table.established()) == {("a", 1, 1), ("b", 1, 1)}
    for k in range(12):
        table.get(("c", 1, 1), (30 + k) * S).note(k, (30 + k) * S)
    assert ("c", 1, 1) in table.established()
    assert {key for key, _ in table.expire(10_000 * S)} == {("b", 1, 1), ("c", 1, 1)}
    assert len(table) == 0


def test_a_session_tells_replayed_reordered_and_new_sequence_numbers():
    session = Session(0)
    seen = [session.note(n, 0) for n in (5, 6, 8, 7, 7, 5, 9, 0xFFFF_FFFF)]
    assert seen == [False, False, False, False, True, True, False, False]
    assert (session.duplicates, session.reordered, session.received) == (2, 2, 8)


def test_the_replay_window_goes_round_with_32_bit_sequences():
    session = Session(0)
    for n in range(0xFFFF_FFF0, 0xFFFF_FFF0 + 40):
        assert not session.note(n & 0xFFFF_FFFF, 0)
    assert session.note(0xFFFF_FFFE, 0)
    assert session.note(3, 0)
    assert not session.note(5_000, 0)
    assert session.reordered == 0
