//! The store over one in memory, and over a server that answers what a test wants.

use super::*;
use crate::objects::Local;
use object_store::memory::InMemory;
use std::io::{BufRead, BufReader};
use std::net::{TcpListener, TcpStream};

/// A store whose bucket `b` is in memory, and that.
fn in_memory() -> (Store, Arc<InMemory>) {
    let (store, memory) = (Store::new(), Arc::new(InMemory::new()));
    lock(&store.buckets).insert("b".into(), Arc::clone(&memory) as Arc<dyn ObjectStore>);
    (store, memory)
}

fn at(text: &str) -> Address {
    Address::parse(text.as_ref()).unwrap()
}

fn read(mut file: File) -> String {
    let mut text = String::new();
    file.read_to_string(&mut text).unwrap();
    text
}

#[test]
fn what_is_put_is_listed_and_read_again() {
    let (store, _) = in_memory();
    for key in ["s3://b/day/b.mcap", "s3://b/day/a.mcap", "s3://b/daylight.mcap"] {
        store.put(&at(key), key.into(), false).unwrap();
    }
    let listed = store.list(&at("s3://b/day/")).unwrap();
    assert_eq!(listed, [at("s3://b/day/a.mcap"), at("s3://b/day/b.mcap")], "daylight is no folder day");
    assert_eq!(read(store.fetch(&listed[1]).unwrap()), "s3://b/day/b.mcap");
    assert!(store.exists(&listed[0]).unwrap() && !store.exists(&at("s3://b/x")).unwrap());
    assert!(matches!(store.put(&listed[0], b"new".to_vec(), false), Err(ObjectError::Exists(_))));
    store.put(&listed[0], b"new".to_vec(), true).unwrap();
    assert_eq!(store.text(&at("s3://b/daylight.mcap"), 20).unwrap(), "s3://b/daylight.mcap");
    assert!(store.text(&at("s3://b/daylight.mcap"), 19).unwrap_err().to_string().contains("at most 19"));
}

#[test]
fn what_vanishes_or_changes_after_the_listing_is_told() {
    let (store, memory) = in_memory();
    for key in ["s3://b/a.mcap", "s3://b/b.mcap"] {
        store.put(&at(key), b"one".to_vec(), false).unwrap();
    }
    let listed = store.list(&at("s3://b")).unwrap();
    let delete = async move { memory.delete(&Key::from("a.mcap")).await };
    store.wait(&listed[0], delete).unwrap().unwrap();
    store.put(&listed[1], b"two".to_vec(), true).unwrap();
    let told = |address| store.fetch(address).unwrap_err();
    assert!(matches!(told(&listed[0]), ObjectError::Gone(_)));
    assert!(matches!(told(&listed[1]), ObjectError::Changed(_)));
    let never = told(&at("s3://b/c.mcap"));
    assert!(matches!(never, ObjectError::Absent(_)) && never.is_of_object(), "{never}");
}

#[test]
fn a_copy_can_be_opened_by_others_and_is_told_under_its_address() {
    let (store, _) = in_memory();
    store.put(&at("s3://b/a.mcap"), b"torn".to_vec(), false).unwrap();
    let local = Local::of("s3://b/a.mcap".as_ref(), &store).unwrap();
    let seen = std::process::Command::new("cat").arg(local.path()).output().unwrap();
    assert_eq!(seen.stdout, b"torn");
    let problem = recording::Recording::open(local.path()).unwrap_err().to_string();
    assert!(local.named(&problem).starts_with("s3://b/a.mcap: "), "{problem}");
    // The number of the descriptor may be another file's at once; the file that it was is gone.
    let path = local.path().to_path_buf();
    let was = std::fs::read_link(&path).unwrap();
    drop(local);
    assert_ne!(std::fs::read_link(path).ok(), Some(was), "nothing is left behind");
}

/// Answers requests on loopback with what `answer` says to their first line, as long as the process
/// lives.
fn server(answer: fn(&str) -> String) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let _ = serve(stream, answer);
        }
    });
    format!("http://{address}")
}

fn serve(mut stream: TcpStream, answer: fn(&str) -> String) -> std::io::Result<()> {
    let mut lines = BufReader::new(stream.try_clone()?).lines();
    let first = lines.next().transpose()?.unwrap_or_default();
    for line in lines {
        if line?.is_empty() {
            break;
        }
    }
    stream.write_all(answer(&first).as_bytes())
}

/// A store whose bucket `b` is at that server, with so few tries that a test need not wait.
fn connected(endpoint: &str) -> Store {
    let retry = RetryConfig { max_retries: 0, ..RetryConfig::default() };
    let builder = AmazonS3Builder::new().with_bucket_name("b").with_endpoint(endpoint).with_allow_http(true);
    let keys = builder.with_access_key_id("id").with_secret_access_key("secret").with_retry(retry);
    let store = Store::new();
    lock(&store.buckets).insert("b".into(), Arc::new(keys.build().unwrap()));
    store
}

fn answer(status: &str, code: &str) -> String {
    let body = format!("<Error><Code>{code}</Code><Message>no</Message></Error>");
    format!("HTTP/1.1 {status}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}", body.len())
}

#[test]
fn a_store_that_refuses_or_lacks_the_bucket_or_is_down_is_told_apart() {
    let refusing = connected(&server(|_| answer("403 Forbidden", "AccessDenied")));
    for problem in
        [refusing.list(&at("s3://b/day")).unwrap_err(), refusing.fetch(&at("s3://b/a.mcap")).unwrap_err()]
    {
        assert!(
            matches!(&problem, ObjectError::Refused { problem, .. } if problem.contains("AccessDenied")),
            "{problem:?}"
        );
    }
    let problem = refusing.fetch(&at("s3://b/a.mcap")).unwrap_err().to_string();
    assert_eq!(problem, "s3://b/a.mcap: the object store refuses it: 403 Forbidden, AccessDenied");
    let expired = connected(&server(|_| answer("403 Forbidden", "ExpiredToken")));
    let problem = expired.fetch(&at("s3://b/a.mcap")).unwrap_err();
    assert!(matches!(&problem, ObjectError::Credentials { .. }) && !problem.is_of_object(), "{problem:?}");
    let bare = connected(&server(|_| answer("404 Not Found", "NoSuchBucket")));
    for problem in [bare.list(&at("s3://b/day")).unwrap_err(), bare.fetch(&at("s3://b/a.mcap")).unwrap_err()]
    {
        assert!(matches!(&problem, ObjectError::NoBucket { .. }) && !problem.is_of_object(), "{problem:?}");
    }
    let ill = connected(&server(|_| answer("503 Slow Down", "SlowDown")));
    let problem = ill.fetch(&at("s3://b/a.mcap")).unwrap_err();
    assert!(matches!(&problem, ObjectError::Unreachable { .. }) && !problem.is_of_object(), "{problem:?}");
}

#[test]
fn an_answer_that_ends_early_is_no_recording() {
    let cutting = connected(&server(|_| {
        let head = "HTTP/1.1 200 OK\r\nContent-Length: 9\r\nETag: \"x\"\r\nLast-Modified: Wed, 25 Sep 2002 08:30:00 GMT\r\n";
        format!("{head}Connection: close\r\n\r\nhalf")
    }));
    let problem = cutting.fetch(&at("s3://b/a.mcap")).unwrap_err();
    assert!(matches!(&problem, ObjectError::Unreachable { .. }), "{problem:?}");
}
