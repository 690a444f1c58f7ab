//! `vitreo bridge --foxglove`: a viewer is shown what is recorded, and those that do not read delay nobody.

use recording::{Recording, live};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Read};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStderr, Command, Stdio};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};
use vitreo_tests::{WATCHDOG, Watchdog, binaries, instance_name, interrupt, vitreo};

/// Viewers that subscribe and never read.
const DEAF: usize = 10;
/// What a message begins with: its kind, the number of the subscription, the time.
const HEAD: usize = 1 + 4 + 8;

struct Bridge {
    child: Child,
    watchdog: Watchdog,
    log: BufReader<ChildStderr>,
    address: String,
}

impl Bridge {
    fn start(instance: &str) -> Self {
        let mut child = Command::new(binaries().join("vitreo"))
            .args(["bridge", "--foxglove", "0", "--igtl", "0", "--instance", instance])
            .env("XDG_CONFIG_HOME", "/nonexistent")
            .stderr(Stdio::piped())
            .spawn()
            .expect("vitreo starts");
        let watchdog = Watchdog::on(child.id());
        let mut log = BufReader::new(child.stderr.take().expect("piped"));
        let mut line = String::new();
        while !line.contains("ws://") {
            line.clear();
            assert!(log.read_line(&mut line).expect("text") > 0, "the bridge ended");
        }
        let address = line.split("ws://").nth(1).expect("an address").trim().to_owned();
        Bridge { child, watchdog, log, address }
    }

    fn end(mut self) -> String {
        interrupt(self.child.id());
        let mut rest = String::new();
        self.log.read_to_string(&mut rest).expect("text");
        assert!(self.child.wait().expect("its end").success(), "{rest}");
        assert!(!self.watchdog.barked(), "hung and was killed: {rest}");
        rest
    }
}

/// A viewer, and what it has subscribed to, by number.
struct Viewer {
    socket: WebSocket<TcpStream>,
    topics: BTreeMap<u32, String>,
}

impl Viewer {
    /// Connects and subscribes to everything that is offered.
    fn connect(address: &str) -> Self {
        let stream = TcpStream::connect(address).expect("the bridge listens");
        stream.set_read_timeout(Some(WATCHDOG)).expect("a time");
        let mut request = format!("ws://{address}/").into_client_request().expect("an address");
        request.headers_mut().insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().expect("text"));
        let (socket, _) = tungstenite::client(request, stream).expect("a WebSocket");
        let mut viewer = Viewer { socket, topics: BTreeMap::new() };
        let channels = viewer.advertised();
        let subscriptions: Vec<Value> = channels
            .iter()
            .enumerate()
            .map(|(i, channel)| json!({"id": i, "channelId": channel["id"]}))
            .collect();
        let topic = |channel: &Value| channel["topic"].as_str().expect("a name").to_owned();
        viewer.topics = channels.iter().enumerate().map(|(i, c)| (i as u32, topic(c))).collect();
        let request = json!({"op": "subscribe", "subscriptions": subscriptions}).to_string();
        viewer.socket.send(Message::text(request)).expect("sent");
        viewer
    }

    /// The channels that are offered, and their schemas as those of a recording.
    fn advertised(&mut self) -> Vec<Value> {
        let mut channels = Vec::new();
        let schemas: BTreeMap<_, _> =
            live::topics(&["poses", "events", "notes", "health"]).into_iter().collect();
        while channels.len() < schemas.len() {
            let Message::Text(text) = self.socket.read().expect("in time") else { continue };
            let said: Value = serde_json::from_str(&text).expect("JSON");
            if said["op"] == "advertise" {
                channels.extend(said["channels"].as_array().expect("channels").clone());
            }
        }
        for channel in &channels {
            let schema = &schemas[channel["topic"].as_str().expect("a name")];
            assert_eq!(
                (channel["encoding"].as_str(), channel["schemaName"].as_str()),
                (Some("protobuf"), Some(&*schema.name))
            );
        }
        channels
    }

    /// Everything until the end of the simulator is announced, by topic.
    fn watch(mut self) -> BTreeMap<String, Vec<Vec<u8>>> {
        let mut seen: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
        loop {
            let Message::Binary(bytes) = self.socket.read().expect("in time") else { continue };
            assert_eq!(bytes[0], 1, "a message");
            let number = u32::from_le_bytes(bytes[1..5].try_into().expect("four"));
            let (topic, message) = (&self.topics[&number], bytes[HEAD..].to_vec());
            let is_end = topic == "notes" && String::from_utf8_lossy(&message).contains("frames forwarded");
            seen.entry(topic.clone()).or_default().push(message);
            if is_end {
                return seen;
            }
        }
    }
}

/// Messages of a recording by topic.
fn recorded(file: &Path) -> BTreeMap<&'static str, BTreeSet<Vec<u8>>> {
    let mut messages: BTreeMap<_, BTreeSet<_>> = BTreeMap::new();
    let recording = Recording::open(file).expect("a recording");
    for (_, item) in recording.items_of(&["poses", "events"]).flatten() {
        messages.entry(item.topic()).or_default().insert(item.encoded());
    }
    messages
}

#[test]
fn a_viewer_is_shown_what_is_recorded_though_others_do_not_read() {
    let name = instance_name();
    let bridge = Bridge::start(&name);
    let deaf: Vec<Viewer> = (0..DEAF).map(|_| Viewer::connect(&bridge.address)).collect();
    let viewer = Viewer::connect(&bridge.address);
    let viewer = std::thread::spawn(move || viewer.watch());
    let folder = tempfile::tempdir().expect("folder");
    let record = folder.path().join("a.mcap");
    let file = record.to_str().expect("UTF-8");
    let run = vitreo(&[
        "run",
        "--no-picture",
        "--direct",
        "--instance",
        &name,
        "--duration",
        "5",
        "--record",
        file,
    ]);
    // A machine that is busy elsewhere may cost fields.
    assert!(matches!(run.code, Some(0 | 3)), "{run:?}");
    let (seen, recorded) = (viewer.join().expect("a viewer"), recorded(&record));
    for (topic, least) in [("poses", 200), ("events", 1)] {
        let same = seen[topic].iter().filter(|message| recorded[topic].contains(*message)).count();
        println!("{topic}: {same} of {} messages are as recorded", seen[topic].len());
        assert!(same >= least && same + 10 > seen[topic].len(), "{topic}: {same} of {}", seen[topic].len());
    }
    // A frame of poses has its transforms beside it, except for bodies that are all lost.
    assert!(seen["/tf"].len() > 200 && seen["/tf"].len() <= seen["poses"].len());
    assert!(seen["health"].len() > 20, "{} heartbeats", seen["health"].len());
    // The last note's line in the log comes after it.
    assert_eq!(seen["/log"].len() + 1, seen["events"].len() + seen["notes"].len());
    drop(deaf);
    let rest = bridge.end();
    assert!(rest.contains("frames forwarded, 0 lost"), "{rest}");
}
