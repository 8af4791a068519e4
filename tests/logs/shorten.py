"""Makes the logs beside it out of ordinary ones: what a replay needs, and nothing for viewers.

    python -m tests.logs.shorten run.mcap tests/logs/name.mcap.xz

Kept are ``/cycle``, ``/events``, attachments and metadata. How each was recorded:

- ``arm2_real_time``: the paper's arm over the user-space bus in real time, frames lost::

    dftc hil paper_example2_urdf --set executor.rate_hz=400 --set duration_s=2.5
      --set 'fault=[{kind="loss", joint="joint1", start_s=1.2, effectiveness=0.5},
                    {kind="frame_loss", bus="can0", probability=0.01}]'

- ``panda_calibrated``: two-stage decision with tests, a payload that nobody mentioned;
  ``SLOW`` is ``--set executor.rate_hz=200``::

    dftc calibrate panda_shoulder_loss SLOW --runs 1 --seconds 15 -o panda.toml
    dftc simulate panda_shoulder_loss SLOW --set control.calibration=panda.toml
      --set duration_s=2.2 --set fault[0].start_s=1.2

- ``panda_safe_stop``: MIT drives, a tracking error that is not allowed::

    dftc simulate panda_shoulder_loss SLOW --set bus.profile=mit --set duration_s=2
      --set fault[0].start_s=0.6 --set supervisor.tracking_error_rad=0.01
"""

from __future__ import annotations

import io
import lzma
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

KEPT = ("/cycle", "/events")


def shorten(source: Path, target: Path) -> None:
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)  # xz compresses better on its own
    writer.start("ros2")
    with source.open("rb") as stream:
        reader = make_reader(stream)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for each in reader.iter_attachments():
            writer.add_attachment(
                each.create_time, each.log_time, each.name, each.media_type, each.data
            )
        channels: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages(topics=list(KEPT)):
            assert schema is not None
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, number
                )
            writer.add_message(
                channels[channel.topic], message.log_time, message.data, message.publish_time
            )
    writer.finish()
    target.write_bytes(lzma.compress(out.getvalue(), preset=9 | lzma.PRESET_EXTREME))


if __name__ == "__main__":
    shorten(Path(sys.argv[1]), Path(sys.argv[2]))
