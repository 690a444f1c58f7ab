//! What a recording says, for viewers that look on while a run goes on: the same topics, schemas and bytes, so that
//! what is laid out for the one fits the other. The health of the processes comes beside them, which is not recorded.

use super::protobuf::{put_bytes, put_uint};
use super::{Item, descriptors, message_name, viewer_messages};
use foxglove::Schema;
use protocol::health::{Health, Process};
use protocol::message::Message;

/// Topic of heartbeats.
const HEALTH: &str = Health::CHANNEL;
/// How messages of all topics are written.
pub const ENCODING: &str = "protobuf";

/// The topics of a list of channels (as [`Item::TOPICS`], and `health`), each with its schema, and with those that
/// viewers show as they are: where bodies are, and the log.
pub fn topics(channels: &[&'static str]) -> Vec<(&'static str, Schema)> {
    let own = channels.iter().filter_map(|channel| Some((*channel, schema(channel)?)));
    let shown = viewer_messages::TOPICS[..2].iter().enumerate();
    let shown = shown.filter_map(|(i, topic)| Some((*topic, viewer_messages::schema(i)?)));
    own.chain(shown).collect()
}

/// Schema of a channel.
fn schema(channel: &str) -> Option<Schema> {
    if channel == HEALTH {
        let name = format!("{}.{}", descriptors::PACKAGE, descriptors::HEALTH);
        return Some(Schema::new(name, ENCODING, descriptors::file_of_health()));
    }
    let topic = Item::TOPICS.iter().position(|topic| *topic == channel)?;
    Some(Schema::new(message_name(topic), ENCODING, descriptors::file_descriptor_set(topic)))
}

/// The messages of an item with their topics: its own, and those for viewers. `realtime_offset_ns` is added to the
/// instants of these to get the time since 1970.
pub fn messages(item: &Item, realtime_offset_ns: u64) -> impl Iterator<Item = (&'static str, Vec<u8>)> {
    let shown = viewer_messages::encode(item, realtime_offset_ns, u64::MAX);
    let shown = shown.into_iter().map(|(topic, bytes)| (viewer_messages::TOPICS[topic], bytes));
    std::iter::once((item.topic(), item.encoded())).chain(shown)
}

/// The message of a heartbeat with its topic.
pub fn heartbeat(beat: &Health) -> (&'static str, Vec<u8>) {
    let mut bytes = Vec::new();
    let process = Process::from_wire(beat.process).map_or("unknown", Process::name);
    put_uint(&mut bytes, 1, beat.instant_ns);
    put_bytes(&mut bytes, 2, process.as_bytes());
    put_uint(&mut bytes, 3, beat.pid.into());
    put_uint(&mut bytes, 4, beat.state.into());
    put_bytes(&mut bytes, 5, beat.text().as_bytes());
    let counts = [beat.received, beat.sent, beat.lost, beat.refused, beat.cpu_ns];
    counts.into_iter().zip(6..).for_each(|(count, number)| put_uint(&mut bytes, number, count));
    (HEALTH, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protobuf::{Fields, Value};
    use crate::samples::any_item;
    use bytemuck::Zeroable;
    use proptest::prelude::*;
    use protocol::message::text_bytes;

    proptest! {
        #[test]
        fn an_item_is_said_as_it_is_recorded(item in any_item()) {
            let said: Vec<_> = messages(&item, 7).collect();
            prop_assert_eq!(&said[0], &(item.topic(), item.encoded()));
            let shown: Vec<_> = viewer_messages::encode(&item, 7, u64::MAX)
                .into_iter()
                .map(|(topic, bytes)| (viewer_messages::TOPICS[topic], bytes))
                .collect();
            prop_assert_eq!(&said[1..], &shown[..]);
        }
    }

    #[test]
    fn every_topic_has_the_schema_of_the_file_and_what_is_none_has_no_topic() {
        let found = topics(&["poses", "events", "health", "nonsense"]);
        let names: Vec<_> = found.iter().map(|(topic, schema)| (*topic, schema.name.as_str())).collect();
        assert_eq!(
            names,
            [
                ("poses", "vitreo.TrackerFrame"),
                ("events", "vitreo.Event"),
                ("health", "vitreo.Health"),
                ("/tf", "foxglove.FrameTransforms"),
                ("/log", "foxglove.Log"),
            ]
        );
        assert_eq!(found[0].1.data, descriptors::file_descriptor_set(3));
    }

    #[test]
    fn a_heartbeat_has_its_numbers_in_their_fields() {
        let beat = Health {
            instant_ns: 1 << 40,
            process: Process::Simcore as u32,
            pid: 3,
            state: 2,
            text: text_bytes("slow"),
            received: 6,
            sent: 7,
            lost: 8,
            refused: 9,
            cpu_ns: 10,
            ..Health::zeroed()
        };
        let (topic, bytes) = heartbeat(&beat);
        let said = |field: Result<(u32, Value<'_>), _>| match field.unwrap() {
            (tag, Value::Varint(number)) => (tag, number.to_string()),
            (tag, Value::Delimited(text)) => (tag, String::from_utf8(text.to_vec()).unwrap()),
            (tag, other) => panic!("{tag}: {other:?}"),
        };
        let said: Vec<(u32, String)> = Fields(&bytes).map(said).collect();
        let expected = ["1099511627776", "simcore", "3", "2", "slow", "6", "7", "8", "9", "10"];
        assert_eq!(said, (1..).zip(expected.map(String::from)).collect::<Vec<_>>());
        let schema = String::from_utf8_lossy(&descriptors::file_of_health()).into_owned();
        assert_eq!((topic, schema.contains("cpu_ns") && schema.contains("Health")), ("health", true));
    }
}
