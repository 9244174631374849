"""Regular work waits for the end of an answer, one long piece after each, and nothing is left out."""

from knee_contact_ros.node.regular_work import RegularWork


def test_work_is_done_when_due_and_a_long_piece_leaves_the_rest_to_the_next_answer(monkeypatch):
    now, done = [100.0], []
    monkeypatch.setattr("time.perf_counter", lambda: now[0])

    def piece(name, duration):
        def act():
            done.append(name)
            now[0] += duration

        return act

    work = RegularWork(
        [(1.0, piece("long", 0.3)), (1.0, piece("short", 0.01)), (0.5, piece("often", 0.0))]
    )
    calls = []
    for at in (100.4, 100.6, 101.05, 101.4, 101.95, 102.9):
        now[0] = at
        work.do_due(at, at + 0.2)
        calls.append([*done])
        done.clear()
    assert calls == [[], ["often"], ["long"], ["short", "often"], ["often"], ["long"]]
    work.do_due(now[0], float("inf"))
    assert done == ["short", "often"]
