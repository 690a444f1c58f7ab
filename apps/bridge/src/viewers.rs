//! A server for viewers (Foxglove, Lichtblick, PlotJuggler): poses, events, remarks and heartbeats, as a recording
//! has them. Its connections are served by a thread of their own; who reads slowly misses the oldest messages.

use anyhow::Context;
use foxglove::{Context as Topics, PartialMetadata, RawChannel, WebSocketServer, WebSocketServerHandle};
use protocol::health::Health;
use protocol::time::Nanos;
use recording::{Item, Note, NoteKind, live};
use settings::commands::bridge::Listen;
use std::collections::BTreeMap;
use std::sync::Arc;
use tokio::runtime::{Builder, Runtime};

/// What viewers are given.
const CHANNELS: [&str; 4] = ["poses", "events", "notes", "health"];
/// Messages that wait for a slow viewer, over all topics: at 200 Hz more than a second.
const WAITING: usize = 1024;

/// The server.
pub struct Viewers {
    channels: BTreeMap<&'static str, Arc<RawChannel>>,
    server: Option<WebSocketServerHandle>,
    runtime: Runtime,
    // The channels know it weakly.
    _topics: Arc<Topics>,
}

impl Viewers {
    /// Listens for viewers. Returns the address too, whose port may have been the system's choice.
    ///
    /// # Errors
    /// Where the address cannot be used.
    pub fn listen(at: &Listen, instance: &str) -> anyhow::Result<(Self, Listen)> {
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
        let topics = Topics::new();
        let mut channels = BTreeMap::new();
        for (topic, schema) in live::topics(&CHANNELS) {
            let builder = topics.channel_builder(topic).schema(schema).message_encoding(live::ENCODING);
            channels.insert(topic, builder.build_raw()?);
        }
        let server = WebSocketServer::new()
            .name(format!("vitreo {instance}"))
            .bind(at.host.as_str(), at.port)
            .message_backlog_size(WAITING)
            .tokio_runtime(runtime.handle())
            .context(&topics);
        let server = runtime.block_on(server.start()).with_context(|| format!("listen on {at}"))?;
        let address = Listen { host: at.host.clone(), port: server.port() };
        Ok((Viewers { channels, server: Some(server), runtime, _topics: topics }, address))
    }

    /// How many are connected.
    pub fn count(&self) -> usize {
        self.server.as_ref().map_or(0, WebSocketServerHandle::client_count)
    }

    /// Hands an item on. `offset_ns` is what is added to an instant to get the time since 1970.
    pub fn show(&self, item: &Item, now: Nanos, offset_ns: u64) {
        if !self.channels.values().any(|channel| channel.has_sinks()) {
            return;
        }
        let at = item.instant_ns().unwrap_or(now);
        for (topic, message) in live::messages(item, offset_ns) {
            self.put(topic, &message, at.wrapping_add(offset_ns));
        }
    }

    /// Hands a heartbeat on.
    pub fn show_health(&self, beat: &Health, offset_ns: u64) {
        let (topic, message) = live::heartbeat(beat);
        self.put(topic, &message, beat.instant_ns.wrapping_add(offset_ns));
    }

    /// Sends a line of log to the viewers.
    pub fn tell(&self, text: String, now: Nanos, offset_ns: u64) {
        let note = Note { instant_ns: now, kind: NoteKind::Log, process: None, count: 1, text };
        self.show(&Item::Note(note), now, offset_ns);
    }

    fn put(&self, topic: &str, message: &[u8], unix_ns: u64) {
        if let Some(channel) = self.channels.get(topic) {
            channel.log_with_meta(message, PartialMetadata::with_log_time(unix_ns));
        }
    }

    /// Closes all.
    pub fn end(&mut self) {
        if let Some(server) = self.server.take() {
            self.runtime.block_on(server.stop().wait());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    #[test]
    fn it_listens_and_needs_nobody_to_be_there() {
        let (mut viewers, at) = Viewers::listen(&"0".parse().unwrap(), "main").unwrap();
        assert!(at.port > 0 && viewers.count() == 0);
        let taken = Viewers::listen(&at, "main").err().map(|e| format!("{e:#}")).unwrap_or_default();
        assert!(taken.contains(&format!("listen on {at}")), "{taken}");
        viewers.show_health(&Health::zeroed(), 5);
        viewers.tell("nobody hears it".into(), 1, 5);
        let names: Vec<_> = viewers.channels.keys().copied().collect();
        assert_eq!(names, ["/log", "/tf", "events", "health", "notes", "poses"]);
        viewers.end();
    }
}
