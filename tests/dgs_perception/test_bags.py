"""Bags written and read back, both storages; damaged, empty and foreign ones."""

from __future__ import annotations

import sqlite3
import subprocess
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from dgs_description.errors import ErrorCode
from dgs_perception.bags import SINGLE_MESSAGE_PERIOD, BagSource, BagWriter
from tests.dgs_perception.bags import (
    DEPTH_TOPIC,
    INFO_TOPIC,
    START_NS,
    camera_info,
    depth_image,
    write,
    write_cloud,
    write_cloud_bag,
    write_depth_bag,
)
from tests.support.refused import refused

STORAGES = ["sqlite3", "mcap"]


def clouds(count: int, points: int = 50) -> list[np.ndarray]:
    return [np.random.default_rng(k).normal(size=(points, 3)).astype(np.float32) for k in range(count)]


def points_of(message) -> np.ndarray:
    assert [field.name for field in message.content.fields] == ["x", "y", "z"]
    assert message.content.point_step == 12 and message.content.row_step == len(message.content.data)
    return message.content.data.view(np.float32).reshape(-1, 3)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_compressed_bag_is_smaller_and_holds_the_same(tmp_path, storage):
    written = [np.ones((5000, 3), np.float32) * k for k in range(3)]
    packed = write_cloud_bag(tmp_path / "packed", written, storage=storage, compress=True)
    (alone,) = (file for file in packed.iterdir() if file.name != "metadata.yaml")  # as after a kill
    for path in (packed, alone):
        with closing(BagSource(path)) as source:
            read = [points_of(message) for message in source.messages()]
        np.testing.assert_array_equal(read, written)
    assert sum(file.stat().st_size for file in packed.iterdir()) < 60_000


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("as_file", [False, True], ids=["folder", "file"])
def test_clouds_survive_the_bag(tmp_path, storage, as_file):
    written = [*clouds(4), np.empty((0, 3), np.float32)]
    folder = write_cloud_bag(tmp_path / "bag", written, storage=storage)
    path = folder / f"bag.{'db3' if storage == 'sqlite3' else 'mcap'}" if as_file else folder
    with closing(BagSource(path)) as source:
        assert (source.topic, source.info_topic) == ("/dgs/cloud", None)
        read = list(source.messages())
    for k, (message, cloud) in enumerate(zip(read, written, strict=True)):
        np.testing.assert_array_equal(points_of(message), cloud)
        stamp = message.content.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == message.time_ns == START_NS + round(k * 1e9 / 30)
        assert message.content.header.frame_id == "base_link"


@pytest.mark.parametrize("storage", STORAGES)
def test_depth_images_come_after_a_camera_info(tmp_path, storage):
    depths = [np.full((4, 6), 700 + k, np.uint16) for k in range(3)]
    with closing(BagSource(write_depth_bag(tmp_path / "bag", depths, 5.0, storage))) as source:
        assert (source.topic, source.info_topic) == (DEPTH_TOPIC, INFO_TOPIC)
        messages = list(source.messages())
    assert messages[0].topic == INFO_TOPIC and messages[0].content.k[0] == 5.0
    images = [message.content for message in messages if message.topic == DEPTH_TOPIC]
    assert [image.data.view(np.uint16)[0] for image in images] == [700, 701, 702]


@pytest.mark.parametrize("storage", STORAGES)
def test_an_exception_while_recording_leaves_a_whole_bag(tmp_path, storage):
    with pytest.raises(KeyboardInterrupt), closing(BagWriter(tmp_path / "bag", storage)) as writer:
        for k, cloud in enumerate(clouds(3)):
            write_cloud(writer, cloud, "base_link", START_NS + k)
        raise KeyboardInterrupt
    with closing(BagSource(tmp_path / "bag")) as source:
        assert len(list(source.messages())) == 3
    writer.close()
    with refused(ErrorCode.BAG_MISSING, "is closed"):
        write_cloud(writer, clouds(1)[0], "base_link", START_NS)


def test_kill_nine_leaves_what_was_committed(tmp_path, monkeypatch):
    """The file as a killed process leaves it: not closed, no metadata."""
    monkeypatch.setattr("dgs_perception.bags.COMMIT_PERIOD", 0.0)
    writer = BagWriter(tmp_path / "bag")
    for k, cloud in enumerate(clouds(3)):
        write_cloud(writer, cloud, "base_link", START_NS + k)
    (left,) = (tmp_path / "bag").glob("*.db3")
    copy = tmp_path / "left.db3"
    copy.write_bytes(left.read_bytes())
    writer.close()
    with sqlite3.connect(copy) as database:
        assert database.execute("SELECT count(*) FROM messages").fetchone() == (3,)
        assert database.execute("SELECT name FROM topics").fetchall() == [("/dgs/cloud",)]
    with closing(BagSource(copy)) as source:
        assert len(list(source.messages())) == 3


def test_a_name_that_sqlite_would_misread_is_refused(tmp_path):
    with refused(ErrorCode.BAG_MISSING, "take the storage mcap"):
        BagWriter(tmp_path / "run #1")
    assert not list(tmp_path.iterdir())
    BagWriter(tmp_path / "run #1", "mcap").close()
    assert [path.name for path in (tmp_path / "run #1").iterdir()]


def test_a_tilde_is_the_users_folder(tmp_path, monkeypatch):
    """In a parameter file, and behind := , no shell sees it."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    write_cloud_bag(Path("~/bag"), clouds(1))
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    BagSource("~/bag").close()


def test_an_existing_bag_is_not_overwritten(tmp_path):
    write_cloud_bag(tmp_path / "bag", clouds(1))
    with refused(ErrorCode.BAG_MISSING, "cannot be created: .*exists already"):
        BagWriter(tmp_path / "bag")


@pytest.mark.parametrize("what", ["nothing", "empty folder", "text file", "no metadata", "cut short"])
def test_what_is_no_bag_is_refused(tmp_path, what):
    path = tmp_path / "bag"
    if what == "empty folder":
        path.mkdir()
    elif what == "text file":
        path = tmp_path / "bag.db3"
        path.write_text("not a database" * 100)
    elif what in ("no metadata", "cut short"):
        write_cloud_bag(path, clouds(2), storage="mcap")
        if what == "no metadata":
            (path / "metadata.yaml").unlink()
        else:
            data = (path / "bag.mcap").read_bytes()
            (path / "bag.mcap").write_bytes(data[: len(data) // 2])
    with refused(ErrorCode.BAG_MISSING, f"No bag can be read at {path}"):
        BagSource(path)


def test_a_bag_of_ros_1_is_refused_with_the_command_that_converts_it(tmp_path):
    path, types = tmp_path / "old.bag", get_typestore(Stores.ROS1_NOETIC)
    with Ros1Writer(path) as writer:
        connection = writer.add_connection("/word", "std_msgs/msg/String", typestore=types)
        word = types.types["std_msgs/msg/String"]("hello")
        writer.write(connection, 1, types.serialize_ros1(word, "std_msgs/msg/String"))
    with refused(ErrorCode.BAG_MISSING, "of ROS 1; convert it: rosbags-convert") as caught:
        BagSource(path)
    command = caught.value.message.partition("convert it: ")[2].replace("FOLDER", str(tmp_path / "new"))
    subprocess.run(command.split(), check=True)
    with refused(ErrorCode.BAG_TOPIC, "/word"):
        BagSource(tmp_path / "new")


def test_damaged_messages_are_left_out_and_a_bag_of_nothing_else_is_reported(tmp_path):
    path = write_cloud_bag(tmp_path / "bag", clouds(2, points=100), storage="mcap")
    data = bytearray((path / "bag.mcap").read_bytes())
    at = 0
    for left in (1, 0):
        at = data.find(b"base_link", at + 1)
        data[at - 4 : at] = (2**31).to_bytes(4, "little")  # the length of the frame id
        (path / "bag.mcap").write_bytes(data)
        with closing(BagSource(path)) as source:
            if left:
                assert len(list(source.messages())) == left
                continue
            with refused(ErrorCode.BAG_MISSING, "is damaged: none of its messages on"):
                list(source.messages())


def test_a_bag_of_nothing_but_camera_infos_that_can_be_read_is_reported(tmp_path):
    path = write_depth_bag(tmp_path / "bag", [np.ones((4, 6), np.uint16)], 5.0, storage="mcap")
    data = bytearray((path / "bag.mcap").read_bytes())
    at = data.find(b"camera_depth_optical_frame")
    data[at - 4 : at] = (2**31).to_bytes(4, "little")
    (path / "bag.mcap").write_bytes(data)
    with closing(BagSource(path)) as source, refused(ErrorCode.BAG_MISSING, "none of its messages"):
        list(source.messages())


def mixed_bag(path, topics):
    with closing(BagWriter(path)) as writer:
        for topic, kind in topics:
            if kind == "cloud":
                write_cloud(writer, clouds(1)[0], "base_link", START_NS, topic)
            elif kind == "info":
                write(writer, topic, camera_info(6, 4, 5.0, START_NS), START_NS)
            else:
                write(writer, topic, depth_image(np.ones((4, 6), np.uint16), START_NS), START_NS)
    return path


@pytest.mark.parametrize(
    ("topics", "wanted", "sentence"),
    [
        ([("/a/color/image_raw", "image")], "", "has neither a PointCloud2 nor a depth image topic"),
        ([("/a", "cloud"), ("/b", "cloud")], "", "several topics that would do"),
        (
            [("/a", "cloud"), ("/b", "cloud")],
            "/c",
            r"has no topic /c .* holds: /a \[sensor_msgs/msg/PointCloud2, 1\], /b",
        ),
        ([("/a", "info")], "/a", "has sensor_msgs/msg/CameraInfo on /a"),
        ([("/depth/image", "image")], "", "has no topic /depth/camera_info"),
    ],
)
def test_topics_that_do_not_fit_are_refused_with_what_the_bag_holds(tmp_path, topics, wanted, sentence):
    with refused(ErrorCode.BAG_TOPIC, sentence) as caught:
        BagSource(mixed_bag(tmp_path / "bag", topics), wanted)
    assert all(topic in caught.value.message for topic, _ in topics)


def test_the_suites_own_cloud_topic_wins(tmp_path):
    path = mixed_bag(tmp_path / "bag", [("/a", "cloud"), ("/dgs/cloud", "cloud"), ("/depth/image", "image")])
    with closing(BagSource(path)) as source:
        assert source.topic == "/dgs/cloud"
    with closing(BagSource(path, "/a")) as source:
        assert source.topic == "/a"


def test_a_topic_without_messages_is_refused(tmp_path):
    with Writer(tmp_path / "bag", version=9) as writer:
        writer.add_connection(
            "/dgs/cloud", "sensor_msgs/msg/PointCloud2", typestore=get_typestore(Stores.ROS2_JAZZY)
        )
    with refused(ErrorCode.BAG_TOPIC, "holds no messages on /dgs/cloud"):
        BagSource(tmp_path / "bag")


def test_an_empty_recording_still_opens_as_a_bag(tmp_path):
    BagWriter(tmp_path / "bag").close()
    with refused(ErrorCode.BAG_TOPIC, "It holds: nothing"):
        BagSource(tmp_path / "bag")


def test_replay_keeps_the_recorded_pace(tmp_path):
    path = write_cloud_bag(tmp_path / "bag", clouds(7), rate=20.0)
    with closing(BagSource(path)) as source:
        start = time.monotonic()
        times = [time.monotonic() - start for _ in source.replay(threading.Event(), rate=2.0, loop=False)]
    np.testing.assert_array_less(np.arange(7) / 40 - 1e-3, times)
    assert times[-1] < 6 / 40 + 1.0  # a busy machine is late, never early


def test_replay_loops_until_it_is_stopped(tmp_path):
    stop, seen = threading.Event(), []
    with closing(BagSource(write_cloud_bag(tmp_path / "bag", clouds(2), rate=100.0))) as source:
        for message in source.replay(stop, rate=10.0):
            seen.append(message.time_ns)
            if len(seen) == 5:
                stop.set()
    assert seen == [START_NS, START_NS + 10_000_000] * 2 + [START_NS]


def one_moment(path, what):
    """A bag that lasts for no time."""
    if what == "depth":
        return write_depth_bag(path, [np.ones((4, 6), np.uint16)], 5.0)
    return write_cloud_bag(path, clouds({"one": 1, "two": 2}[what]), rate=np.inf)


@pytest.mark.parametrize("what", ["one", "two", "depth"])
def test_a_bag_of_one_moment_loops_with_a_pause(tmp_path, what):
    stop, times = threading.Event(), []
    with closing(BagSource(one_moment(tmp_path / "bag", what))) as source:
        for message in source.replay(stop):
            times += [time.monotonic()] * (message.topic == source.topic)
            if len(times) == 3:
                stop.set()
    assert times[-1] - times[0] > 0.9 * SINGLE_MESSAGE_PERIOD
    source.close()


def test_the_pace_is_that_of_the_images_wherever_camera_infos_stand(tmp_path):
    with closing(BagWriter(tmp_path / "bag")) as writer:
        for k in range(3):
            stamp = START_NS + k * 10**8
            write(writer, DEPTH_TOPIC, depth_image(np.ones((4, 6), np.uint16), stamp), stamp)
        write(writer, INFO_TOPIC, camera_info(6, 4, 5.0, stamp), stamp + 1000)
    stop, times = threading.Event(), []
    with closing(BagSource(tmp_path / "bag")) as source:
        start = time.monotonic()
        for message in source.replay(stop):
            times += [time.monotonic() - start] * (message.topic == DEPTH_TOPIC)
            if len(times) == 4:
                stop.set()
    np.testing.assert_array_less(0.1 * np.arange(4) - 1e-3, times)


def test_stopping_ends_a_pause_at_once(tmp_path):
    stop = threading.Event()
    with closing(BagSource(write_cloud_bag(tmp_path / "bag", clouds(2), rate=0.01))) as source:
        messages = source.replay(stop)
        next(messages)
        threading.Timer(0.1, stop.set).start()
        start = time.monotonic()
        assert list(messages) == []
        assert time.monotonic() - start < 5.0
