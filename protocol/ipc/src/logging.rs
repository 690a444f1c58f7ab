//! Logging of every process: `tracing` records on standard error, as text or as JSON lines.
//!
//! A text line holds the time (UTC), the level, the process, the message and the fields:
//! `2026-11-22T13:55:38.123456Z WARN tracker: frame withheld field=7`. A JSON line holds the same
//! under `time`, `level`, `process`, `target` and `message`; the other keys are the fields of the
//! record. A record about one camera field or frame carries its number as `field`.
//!
//! Records of the `log` crate, which graphics libraries use, come out in the same form. No span is
//! opened, and a record that the filter leaves out costs one comparison and allocates nothing. A record
//! that repeats is written at most once a second, with its count as `repeated`.

mod repeats;

use clap::ArgAction;
use outputs::exit::{FAILED, WRONG_USE, WrongUse};
use outputs::printable;
use repeats::Repeats;
use serde_json::{Map, Value};
use std::fmt::{self, Debug, Write as _};
use std::io::{IsTerminal, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Instant;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_log::NormalizeEvent;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::{FormatTime, SystemTime};
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::prelude::*;
use tracing_subscriber::registry::LookupSpan;

/// Environment variable with the filter; `--log` takes precedence, `-v` and `-q` do not.
const FILTER_VARIABLE: &str = "RUST_LOG";
/// Levels from silence on; `-v` goes up, `-q` down.
const LEVELS: [LevelFilter; 6] = [
    LevelFilter::OFF,
    LevelFilter::ERROR,
    LevelFilter::WARN,
    LevelFilter::INFO,
    LevelFilter::DEBUG,
    LevelFilter::TRACE,
];
/// Index of the default level in [`LEVELS`]: warn.
const DEFAULT_LEVEL: u8 = 2;

/// Options of logging, taken by every program.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct LogArgs {
    /// Log level (error, warn, info, debug, trace, off) or a filter such as warn,tracker=debug [default:
    /// RUST_LOG, or warn].
    #[arg(long = "log", value_name = "FILTER", global = true, help_heading = "Messages")]
    pub filter: Option<Targets>,
    /// More messages: -v info, -vv debug, -vvv trace; --log and RUST_LOG take precedence.
    #[arg(short, long, global = true, action = ArgAction::Count, help_heading = "Messages")]
    pub verbose: u8,
    /// Fewer messages: -q errors only, -qq none.
    #[arg(short, long, global = true, action = ArgAction::Count, help_heading = "Messages")]
    pub quiet: u8,
    /// Format of the messages on standard error.
    #[arg(
        long,
        value_name = "FORMAT",
        global = true,
        value_enum,
        default_value_t,
        help_heading = "Messages"
    )]
    pub log_format: LogFormat,
}

/// Format of the messages on standard error.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// Plain text.
    #[default]
    Text,
    /// One JSON object per line.
    Json,
}

impl LogArgs {
    /// The options as arguments of another program of this build.
    pub fn to_arguments(&self) -> Vec<String> {
        let filter = self.filter.iter().flat_map(|f| ["--log".to_owned(), f.to_string()]);
        let times = |flag: &str, times: u8| vec![flag.to_owned(); times.into()];
        let level = times("-v", self.verbose).into_iter().chain(times("-q", self.quiet));
        let json = (self.log_format == LogFormat::Json).then(|| "--log-format=json".to_owned());
        filter.chain(level).chain(json).collect()
    }

    /// The level that `-v` and `-q` ask for.
    fn level(&self) -> LevelFilter {
        let steps = i16::from(DEFAULT_LEVEL) + i16::from(self.verbose) - i16::from(self.quiet);
        LEVELS[steps.clamp(0, LEVELS.len() as i16 - 1) as usize]
    }
}

/// What [`init`] was given.
struct Logging {
    process: &'static str,
    args: LogArgs,
}

static LOGGING: OnceLock<Logging> = OnceLock::new();

/// Writes the records of this program to standard error from now on, under the name `process`.
/// The first call of a program counts; later ones do nothing.
pub fn init(process: &'static str, args: &LogArgs) {
    if LOGGING.set(Logging { process, args: args.clone() }).is_err() {
        return;
    }
    let variable = std::env::var(FILTER_VARIABLE).ok().filter(|text| !text.is_empty());
    match (&args.filter, variable.map(|text| text.parse::<Targets>())) {
        (Some(filter), _) => subscribe(process, args.log_format, filter.clone()),
        (None, Some(Ok(filter))) => subscribe(process, args.log_format, filter),
        (None, other) => {
            subscribe(process, args.log_format, Targets::new().with_default(args.level()));
            if let Some(Err(error)) = other {
                tracing::warn!("{FILTER_VARIABLE} is not a filter, and is ignored: {error}");
            }
        }
    }
    if args.log_format == LogFormat::Json {
        std::panic::set_hook(Box::new(|panic| message(Level::ERROR, &panic.to_string())));
    }
}

fn subscribe(process: &'static str, format: LogFormat, filter: Targets) {
    let colours = format == LogFormat::Text
        && std::io::stderr().is_terminal()
        && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty());
    let lines = tracing_subscriber::fmt::layer()
        .event_format(Lines { process, format, colours, repeats: Mutex::default() })
        .with_writer(std::io::stderr);
    // A program that embeds this crate may have its own subscriber; that one stays.
    let _ = tracing_subscriber::registry().with(lines.with_filter(filter)).try_init();
}

/// The logging options of this program, for the programs that it starts.
pub fn arguments() -> Vec<String> {
    LOGGING.get().map(|l| l.args.to_arguments()).unwrap_or_default()
}

/// True if standard error carries JSON lines.
pub fn is_json() -> bool {
    LOGGING.get().is_some_and(|l| l.args.log_format == LogFormat::Json)
}

/// Writes a message of the program to the person who started it: `program: text`, or with
/// `--log-format json` a record. The filter does not apply.
pub fn message(level: Level, text: &str) {
    let line = match LOGGING.get() {
        Some(Logging { process, args }) if args.log_format == LogFormat::Json => {
            let head = Head { process, level, target: process };
            let fields = Map::from_iter([("message".to_owned(), Value::from(text))]);
            head.json(fields)
        }
        _ => format!("{}: {}", program(), printable(text)),
    };
    // A closed standard error is no reason to fail.
    let _ = std::io::stderr().write_all(format!("{line}\n").as_bytes());
}

/// Writes a [`message`] of what the program has done.
pub fn inform(text: &str) {
    message(Level::INFO, text);
}

/// Writes a [`message`] of what the program could not do.
pub fn warn(text: &str) {
    message(Level::WARN, text);
}

/// Writes why the program fails, with all causes, and returns the exit code: that of wrong use if [`WrongUse`] is among the
/// causes, otherwise that of a failure.
pub fn fail(error: &(dyn std::error::Error + 'static)) -> ExitCode {
    message(Level::ERROR, &with_causes(error));
    let causes = std::iter::successors(Some(error), |cause| cause.source());
    let code = if causes.into_iter().any(|cause| cause.is::<WrongUse>()) { WRONG_USE } else { FAILED };
    ExitCode::from(code)
}

/// Writes why a program cannot begin to work, before [`init`] was called, and returns the exit code of
/// wrong use.
pub fn wrong_use(
    process: &'static str,
    args: &LogArgs,
    error: &(dyn std::error::Error + 'static),
) -> ExitCode {
    init(process, args);
    fail(error);
    ExitCode::from(WRONG_USE)
}

/// Name under which the program was started: the launcher starts sub-commands under its own.
fn program() -> String {
    let path = std::env::args_os().next().map(PathBuf::from);
    path.as_deref().and_then(|p| p.file_name()).unwrap_or_default().to_string_lossy().into_owned()
}

/// An error with its causes; a cause that the text before it contains already is left out.
pub fn with_causes(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(inner) = cause {
        let inner_text = inner.to_string();
        if !text.contains(&inner_text) {
            text = format!("{text}: {inner_text}");
        }
        cause = inner.source();
    }
    text
}

/// Writes a record as one line.
struct Lines {
    process: &'static str,
    format: LogFormat,
    /// The level in its colour: for terminals. The layer's own setting would need a feature of its
    /// crate.
    colours: bool,
    repeats: Mutex<Repeats>,
}

/// What every record has.
struct Head<'a> {
    process: &'a str,
    level: Level,
    target: &'a str,
}

/// The present time, RFC 3339 in UTC.
fn time() -> String {
    let mut text = String::new();
    // Writing to a string does not fail.
    let _ = SystemTime.format_time(&mut Writer::new(&mut text));
    text
}

impl Head<'_> {
    fn json(&self, fields: Map<String, Value>) -> String {
        let mut all = Map::from_iter([
            ("time".to_owned(), Value::from(time())),
            ("level".to_owned(), Value::from(self.level.as_str())),
            ("process".to_owned(), Value::from(self.process)),
            ("target".to_owned(), Value::from(self.target)),
        ]);
        all.extend(fields);
        Value::Object(all).to_string()
    }

    fn text(&self, fields: &Map<String, Value>, colours: bool) -> String {
        let (colour, plain) = match (colours, self.level) {
            (false, _) => ("", ""),
            (true, Level::ERROR) => ("\x1b[31m", "\x1b[0m"),
            (true, Level::WARN) => ("\x1b[33m", "\x1b[0m"),
            (true, _) => ("\x1b[2m", "\x1b[0m"),
        };
        let mut line = format!("{} {colour}{:5}{plain} {}:", time(), self.level.as_str(), self.process);
        let message = fields.get("message").and_then(Value::as_str).unwrap_or_default();
        let _ = write!(line, " {}", printable(message));
        for (name, value) in fields.iter().filter(|(name, _)| *name != "message") {
            let _ = write!(line, " {name}={value}");
        }
        line
    }
}

impl Lines {
    fn line(&self, head: &Head<'_>, fields: Map<String, Value>) -> String {
        match self.format {
            LogFormat::Text => head.text(&fields, self.colours),
            LogFormat::Json => head.json(fields),
        }
    }
}

impl<S, N> FormatEvent<S, N> for Lines
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        _: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let normalized = event.normalized_metadata();
        let metadata = normalized.as_ref().unwrap_or_else(|| event.metadata());
        let head = Head { process: self.process, level: *metadata.level(), target: metadata.target() };
        let mut fields = Fields(Map::new());
        event.record(&mut fields);
        let key = fields.0.get("message").and_then(Value::as_str).unwrap_or_default();
        let now = Instant::now();
        let mut repeats = self.repeats.lock().unwrap_or_else(PoisonError::into_inner);
        for (message, level, times) in repeats.overdue(now) {
            let head = Head { level, ..head };
            let held_back = [("message", Value::from(message)), ("repeated", times.into())];
            let held_back = Map::from_iter(held_back.map(|(name, value)| (name.to_owned(), value)));
            writeln!(writer, "{}", self.line(&head, held_back))?;
        }
        match repeats.admit(key, head.level, now) {
            None => return Ok(()),
            Some(0) => {}
            Some(times) => fields.put_count(times),
        }
        drop(repeats);
        let line = self.line(&head, fields.0);
        writeln!(writer, "{line}")
    }
}

/// Collects the fields of a record. Those with a dot come from the bridge to the `log` crate and
/// repeat the metadata.
struct Fields(Map<String, Value>);

impl Fields {
    /// How often the record came since it was written last.
    fn put_count(&mut self, times: u64) {
        self.0.insert("repeated".to_owned(), times.into());
    }

    fn put(&mut self, field: &Field, value: Value) {
        if !field.name().contains('.') {
            self.0.insert(field.name().to_owned(), value);
        }
    }
}

impl Visit for Fields {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.put(field, format!("{value:?}").into());
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.put(field, value.into());
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.put(field, value.into());
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.put(field, value.into());
    }

    fn record_f64(&mut self, field: &Field, value: f64) {
        self.put(field, value.into());
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.put(field, value.into());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use rig::Rig;
    use std::sync::{Arc, Mutex};

    /// A writer that keeps what was written.
    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<Vec<u8>>>);

    impl std::io::Write for Kept {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    /// The lines that `work` logs at level info and above.
    fn lines(format: LogFormat, colours: bool, work: impl FnOnce()) -> Vec<String> {
        let kept = Kept::default();
        let writer = kept.clone();
        let layer = tracing_subscriber::fmt::layer()
            .event_format(Lines { process: "tracker", format, colours, repeats: Mutex::default() })
            .with_writer(move || writer.clone());
        let filter = "info".parse::<Targets>().unwrap();
        tracing::subscriber::with_default(
            tracing_subscriber::registry().with(layer.with_filter(filter)),
            work,
        );
        let text = String::from_utf8(kept.0.lock().unwrap().clone()).unwrap();
        text.lines().map(str::to_owned).collect()
    }

    fn records() {
        tracing::warn!(field = 7_u64, depth_mm = 0.5, "frame withheld: \"x\"");
        tracing::debug!("left out");
        tracing::info!(late = true, "two\nlines");
    }

    #[test]
    fn a_json_line_holds_process_level_message_and_field_number() {
        let lines = lines(LogFormat::Json, false, records);
        assert_eq!(lines.len(), 2, "{lines:?}");
        let first: Value = serde_json::from_str(&lines[0]).unwrap();
        assert_eq!((&first["field"], &first["depth_mm"]), (&7.into(), &0.5.into()));
        assert_eq!((&first["level"], &first["process"]), (&"WARN".into(), &"tracker".into()));
        assert_eq!(first["message"], "frame withheld: \"x\"");
        assert!(first["time"].as_str().is_some_and(|t| t.ends_with('Z')), "{first}");
        let second: Value = serde_json::from_str(&lines[1]).unwrap();
        assert_eq!((&second["message"], &second["late"]), (&"two\nlines".into(), &true.into()));
    }

    #[test]
    fn a_text_line_holds_time_level_process_and_fields() {
        let lines = lines(LogFormat::Text, false, records);
        let (time, rest) = lines[0].split_once(' ').unwrap();
        assert!(time.starts_with("20") && time.ends_with('Z'), "{time}");
        assert_eq!(rest, "WARN  tracker: frame withheld: \"x\" depth_mm=0.5 field=7");
    }

    #[test]
    fn a_flood_of_one_record_is_one_line() {
        let flood = || (0..50).for_each(|field: u64| tracing::error!(field, "frame withheld"));
        let lines = lines(LogFormat::Text, false, flood);
        assert_eq!(lines.len(), 1, "{lines:?}");
    }

    #[test]
    fn a_terminal_gets_the_level_in_its_colour() {
        let lines = lines(LogFormat::Text, true, records);
        assert!(lines[0].contains("\x1b[") && lines[0].contains("WARN"), "{lines:?}");
    }

    #[test]
    fn the_options_pass_to_another_program() {
        #[derive(Parser)]
        struct Line {
            #[command(flatten)]
            log: LogArgs,
        }
        let parse = |words: &[String]| {
            Line::try_parse_from(std::iter::once("x".to_owned()).chain(words.iter().cloned()))
        };
        let words = ["--log", "warn,tracker=debug", "--log-format", "json"].map(str::to_owned);
        let args = parse(&words).unwrap().log;
        let again = parse(&args.to_arguments()).unwrap().log;
        assert_eq!((again.filter, again.log_format), (args.filter, LogFormat::Json));
        assert!(LogArgs::default().to_arguments().is_empty());
        assert!(parse(&["--log-format".to_owned(), "xml".to_owned()]).is_err());
        assert!(parse(&["--log".to_owned(), "tracker=loud".to_owned()]).is_err());
    }

    #[test]
    fn each_v_is_one_level_more_and_each_q_one_less() {
        let level = |verbose, quiet| LogArgs { verbose, quiet, ..LogArgs::default() }.level();
        let levels = [level(0, 2), level(0, 1), level(0, 0), level(1, 0), level(2, 0), level(3, 0)];
        assert_eq!(levels, LEVELS);
        assert_eq!((level(255, 0), level(0, 255), level(2, 2)), (LEVELS[5], LEVELS[0], LEVELS[2]));
        let args = LogArgs { verbose: 2, quiet: 1, ..LogArgs::default() };
        assert_eq!(args.to_arguments(), ["-v", "-v", "-q"]);
    }

    #[test]
    fn no_cause_is_repeated() {
        let error = Rig::load(std::path::Path::new("/nowhere/rig.json")).unwrap_err();
        let text = with_causes(&error);
        assert_eq!(text.matches("No such file").count(), 1, "{text}");
        assert!(text.contains("/nowhere/rig.json"), "{text}");
    }
}
