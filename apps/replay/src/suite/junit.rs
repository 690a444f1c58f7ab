//! The outcome of a suite as JUnit XML, which build servers show.

use super::Outcome;
use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};
use std::io;

/// The whole file.
///
/// # Errors
/// Where memory refuses it.
pub fn xml(suite: &str, outcomes: &[Outcome]) -> io::Result<String> {
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 2);
    writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    let [failed, errors] = [false, true].map(|error| outcomes.iter().filter(|o| o.has_failed(error)).count());
    let seconds: f64 = outcomes.iter().map(|outcome| outcome.seconds).sum();
    let totals = [
        ("name", suite.to_owned()),
        ("tests", outcomes.len().to_string()),
        ("failures", failed.to_string()),
        ("errors", errors.to_string()),
        ("time", format!("{seconds:.3}")),
    ];
    let totals = totals.iter().map(|(key, value)| (*key, value.as_str()));
    writer
        .create_element("testsuite")
        .with_attributes(totals)
        .write_inner_content(|writer| outcomes.iter().try_for_each(|outcome| case(writer, suite, outcome)))?;
    String::from_utf8(writer.into_inner()).map_err(io::Error::other)
}

fn case(writer: &mut Writer<Vec<u8>>, suite: &str, outcome: &Outcome) -> io::Result<()> {
    let seconds = format!("{:.3}", outcome.seconds);
    let keys = [("classname", suite), ("name", &*outcome.name), ("time", &*seconds)];
    writer.create_element("testcase").with_attributes(keys).write_inner_content(|writer| {
        let (kind, texts) = match &outcome.checked {
            Ok(checked) => ("failure", checked.failures.clone()),
            Err(problem) => ("error", vec![problem.clone()]),
        };
        for text in &texts {
            let element = writer.create_element(kind).with_attribute(("message", text.as_str()));
            element.write_text_content(BytesText::new(text))?;
        }
        writer.create_element("system-out").write_text_content(BytesText::new(&outcome.text()))?;
        Ok(())
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::case::Checked;
    use super::*;
    use quick_xml::Reader;

    #[test]
    fn every_case_and_what_failed_stand_in_it() {
        let outcome = |name: &str, checked| Outcome { name: name.into(), checked, seconds: 0.5 };
        let failures = vec!["score, total: expected 90 to 100, found <12>".to_owned()];
        let outcomes = [
            outcome("good", Ok(Checked { compared: 3, verified: 200, ..Checked::default() })),
            outcome("bad & sad", Ok(Checked { compared: 1, failures, ..Checked::default() })),
            outcome("gone", Err("a.mcap: No such file".into())),
        ];
        let text = xml("a.toml", &outcomes).unwrap();
        assert!(text.contains("tests=\"3\" failures=\"1\" errors=\"1\" time=\"1.500\""), "{text}");
        assert!(text.contains("bad &amp; sad") && text.contains("found &lt;12&gt;"), "{text}");
        let (mut reader, mut cases) = (Reader::from_str(&text), 0);
        loop {
            match reader.read_event().unwrap() {
                Event::Start(element) => cases += u32::from(element.name().as_ref() == b"testcase"),
                Event::Eof => break,
                _ => {}
            }
        }
        assert_eq!(cases, 3);
    }
}
