#!/usr/bin/env python3
"""score_from_store.py VITREO FOLDER: scores the recordings of a folder out of an object store.

Starts a server that speaks S3 on loopback, puts the recordings there, scores them in shards whose
workers are killed (SIGKILL) at random and started again, and holds the result to that of the same
files on disk. Then what can be wrong: shards lost or cut, a store that refuses, a bucket that is not
there, an object that vanishes between listing and reading. VITREO is built with the feature
object-store. Exit code 1 where something is wrong.
"""

import csv
import io
import logging
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import boto3
from moto.server import ThreadedMotoServer

BUCKET, SHARDS, KILLS, AT_ONCE, LIMIT_S = "fleet", 20, 30, 3, 600


class Store:
    """The server, and what is asked of vitreo with it."""

    def __init__(self, vitreo):
        self.vitreo = vitreo
        logging.getLogger("werkzeug").setLevel(logging.ERROR)
        self.server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
        self.server.start()
        host, port = self.server.get_host_and_port()
        self.endpoint = f"http://{host}:{port}"
        keys = {"aws_access_key_id": "id", "aws_secret_access_key": "secret", "region_name": "us-east-1"}
        self.client = boto3.client("s3", endpoint_url=self.endpoint, **keys)
        self.client.create_bucket(Bucket=BUCKET)

    def environment(self, **more):
        kept = {k: v for k, v in os.environ.items() if not k.startswith("AWS_")}
        own = {"AWS_ENDPOINT_URL": self.endpoint, "AWS_REGION": "us-east-1"}
        own |= {"AWS_ACCESS_KEY_ID": "id", "AWS_SECRET_ACCESS_KEY": "secret"}
        return kept | own | more

    def start(self, *words, **environment):
        command = [self.vitreo, "score", *map(str, words)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen(command, env=self.environment(**environment), **pipes)

    def score(self, *words, **environment):
        """Exit code, standard output and standard error."""
        process = self.start(*words, **environment)
        out, told = process.communicate(timeout=LIMIT_S)
        return process.returncode, out, told

    def names(self, prefix):
        pages = self.client.get_paginator("list_objects_v2").paginate(Bucket=BUCKET, Prefix=prefix)
        return {o["Key"]: (o["ETag"], o["LastModified"]) for page in pages for o in page.get("Contents", [])}


def check(holds, what):
    if not holds:
        sys.exit(f"wrong: {what}")


def table(text):
    return list(csv.DictReader(io.StringIO(text)))


def shard(index, out="scores"):
    place = f"s3://{BUCKET}/{out}"
    return ("--manifest", f"s3://{BUCKET}/manifest.txt", "--shard", f"{index}/{SHARDS}", "--out", place, "--resume")


def gathered(store, code, out="scores"):
    found, text, told = store.score("--gather", f"s3://{BUCKET}/{out}", "--csv", "-")
    check(found == code, f"gather ends with {found}, not {code}: {told}")
    return text, told


def fill(store, recordings):
    """Puts the recordings, and a manifest that names one of them twice, one of equal content, and one that is torn."""
    for file in recordings:
        store.client.upload_file(str(file), BUCKET, f"day/{file.name}")
    store.client.upload_file(str(recordings[0]), BUCKET, "day/copy.mcap")
    torn = recordings[1].read_bytes()
    store.client.put_object(Bucket=BUCKET, Key="day/torn.mcap", Body=torn[: len(torn) // 2])
    names = [f"day/{file.name}" for file in recordings] + [f"s3://{BUCKET}/day/copy.mcap", "day/torn.mcap"]
    manifest = "\n".join([*names, f"day/{recordings[2].name}"])
    store.client.put_object(Bucket=BUCKET, Key="manifest.txt", Body=manifest.encode())
    return len(names)


def work(store, kills):
    """Does every shard, AT_ONCE at a time; kills so many workers, whose shards wait again."""
    waiting, running, killed, told = list(range(SHARDS)), {}, 0, {}
    end = time.monotonic() + LIMIT_S
    while waiting or running:
        check(time.monotonic() < end, "the shards do not end")
        while waiting and len(running) < AT_ONCE:
            index = waiting.pop(0)
            running[index] = store.start(*shard(index))
        time.sleep(random.uniform(0.01, 0.3))
        index = random.choice(list(running))
        if killed < kills and running[index].poll() is None:
            running[index].kill()
            killed += 1
        for index, process in list(running.items()):
            if process.poll() is None:
                continue
            told[index] = process.communicate()[1]
            check(process.returncode in (0, 3, -9), f"shard {index} ends with {process.returncode}: {told[index]}")
            del running[index]
            if process.returncode == -9:
                waiting.append(index)
    return killed, told


def killed_workers(store, recordings):
    count = fill(store, recordings)
    begun = time.monotonic()
    killed, told = work(store, KILLS)
    took = time.monotonic() - begun
    check(killed > 0, "no worker lived long enough to be killed: nothing was shown")
    text, summary = gathered(store, 3)
    rows = table(text)
    check(len(rows) == count == len({row["file"] for row in rows}), f"{len(rows)} rows for {count} recordings")
    torn = [row["file"] for row in rows if row["problem"]]
    check(torn == [f"s3://{BUCKET}/day/torn.mcap"], f"with problems: {torn}")
    same = {row["file"]: row["same_as"] for row in rows if row["same_as"]}
    first = f"s3://{BUCKET}/day/{recordings[0].name}"
    check(same == {f"s3://{BUCKET}/day/copy.mcap": first}, f"of equal content: {same}")
    check(sum("named 2 times" in words for words in told.values()) == 1, "one is named twice, and one shard says so")
    print(f"{count} recordings in {SHARDS} shards, {killed} workers killed, {took:.1f} s: every row once")
    print(f"  {summary.splitlines()[-1]}")

    before = store.names("scores/")
    _, told = work(store, 0)
    check(all("complete, skipped" in words for words in told.values()), "a finished shard was done again")
    check(store.names("scores/") == before, "a finished shard was put again")
    return text


def as_on_disk(store, recordings, text):
    with tempfile.TemporaryDirectory() as folder:
        for file in recordings:
            shutil.copy(file, folder)
        begun = time.monotonic()
        code, out, told = store.score(folder, "--csv", "-")
        took = time.monotonic() - begun
        check(code == 0, told)
    begun = time.monotonic()
    code, again, told = store.score(f"s3://{BUCKET}/day/", "--csv", "-")
    over = time.monotonic() - begun
    check(code == 3, told)
    own = {"file", "recording", "same_as"}
    rows = {Path(r["file"]).name: {k: v for k, v in r.items() if k not in own} for r in table(out)}
    for made in (text, again):
        for row in table(made):
            name = Path(row["file"]).name
            if name in rows:
                check(rows[name] == {k: v for k, v in row.items() if k not in own}, f"{name} differs from disk")
    print(f"same figures as on disk; one process: {took:.2f} s from disk, {over:.2f} s from the store")


def lost_and_cut(store, text):
    before = store.names("scores/")
    lost, cut = sorted(before)[3], sorted(before)[7]
    store.client.delete_object(Bucket=BUCKET, Key=lost)
    body = store.client.get_object(Bucket=BUCKET, Key=cut)["Body"].read()
    store.client.put_object(Bucket=BUCKET, Key=cut, Body=body[:-100])
    out, told = gathered(store, 1)
    check(out == "", "a result was given out without two of its shards")
    for name, what in [(lost, "missing"), (cut, "truncated or damaged")]:
        check(f"{Path(name).name}: {what}" in told, f"{name} is not named: {told}")
    work(store, 0)
    check(gathered(store, 3)[0] == text, "the rows differ after two shards were done again")
    after = store.names("scores/")
    changed = {name for name in before if before[name] != after[name]}
    check(changed == {lost, cut}, f"done again were {changed}")
    print("a lost and a cut shard were named, and only they done again")


class Between(BaseHTTPRequestHandler):
    """Passes everything on to the store, but for what a case wants: what is listed and vanishes before
    the listing arrives, and what is refused with a code."""

    store, victim, refused, code = None, None, None, "AccessDenied"

    def do_GET(self):
        status, headers, body = self.passed_on()
        if self.victim and "list-type=2" in self.path:
            self.store.client.delete_object(Bucket=BUCKET, Key=self.victim)
        if self.refused and self.refused in self.path:
            status, body = 403, f"<Error><Code>{self.code}</Code><Message>no</Message></Error>".encode()
        self.send_response(status)
        for name in ("ETag", "Last-Modified", "Content-Type"):
            if headers[name]:
                self.send_header(name, headers[name])
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def passed_on(self):
        request = urllib.request.Request(self.store.endpoint + self.path, headers=dict(self.headers))
        try:
            answer = urllib.request.urlopen(request)
        except urllib.error.HTTPError as problem:
            answer = problem
        return answer.status, answer.headers, answer.read()

    def log_message(self, *_):
        pass


def between(store, **case):
    """Scores five recordings through it; exit code, rows and standard error."""
    handler = type("Case", (Between,), {"store": store, **case})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    endpoint = f"http://127.0.0.1:{server.server_address[1]}"
    code, out, told = store.score(f"s3://{BUCKET}/few/", "--csv", "-", AWS_ENDPOINT_URL=endpoint)
    server.shutdown()
    return code, table(out), told


def vanished_and_refused(store, recordings):
    for file in recordings[:5]:
        store.client.upload_file(str(file), BUCKET, f"few/{file.name}")
    key = f"few/{recordings[3].name}"
    cases = [
        ("403 Forbidden, AccessDenied", {"refused": key}),
        ("was listed but no longer exists", {"victim": key}),
    ]
    for words, case in cases:
        code, rows, told = between(store, **case)
        problems = {row["file"]: row["problem"] for row in rows if row["problem"]}
        check(code == 3 and list(problems) == [f"s3://{BUCKET}/{key}"], f"{code} {problems} {told}")
        check(words in problems[f"s3://{BUCKET}/{key}"] and len(rows) == 5, f"{problems} {told}")
        check("5 recordings, 1 with problems" in told, told)
    store.client.upload_file(str(recordings[3]), BUCKET, key)
    cases = [
        ("a listing that is refused", "refuses it: 403 Forbidden, AccessDenied", {"refused": "list-type=2"}),
        ("all that are refused", "so are all 5 recordings; nothing was written", {"refused": ".mcap"}),
        ("credentials that expire", "ExpiredToken", {"refused": key, "code": "ExpiredToken"}),
    ]
    for what, words, case in cases:
        code, rows, told = between(store, **case)
        check(code == 1 and words in told and rows == [], f"{what}: exit code {code}, {told}")
    print("an object that vanished after the listing and one that is refused: named and counted;")
    print("  a listing, all objects or credentials refused: named, and no result")


def refusals(store, recordings):
    one = f"s3://{BUCKET}/day/{recordings[0].name}"
    nobody = {"AWS_SKIP_SIGNATURE": "true"}
    cases = [
        ("a store that nobody may read", 1, "refuses it: 403 Forbidden", (one,), nobody),
        ("the same, all below", 1, "so are all 5 recordings", (f"s3://{BUCKET}/few/",), nobody),
        ("a bucket that is not there", 1, "no such bucket: 'nowhere'", ("s3://nowhere/day/",), {}),
        ("its place for results", 1, "no such bucket: 'nowhere'", (one, "--out", "s3://nowhere/scores"), {}),
        ("an object that is not there", 1, "no such object", (f"s3://{BUCKET}/none.mcap",), {}),
        ("nothing below a prefix", 1, "found none", (f"s3://{BUCKET}/none/",), {}),
        ("an address without a bucket", 2, "expected s3://BUCKET/KEY", ("s3:///day/a.mcap",), {}),
        ("an address of another kind", 2, "expected s3://BUCKET/KEY", ("gs://fleet/day/a.mcap",), {}),
        ("CSV at an address", 2, "expected a path", (one, "--csv", f"s3://{BUCKET}/a.csv"), {}),
        ("shards that are there already", 1, "--force", shard(3)[:-1], {}),
        ("a store that is not there", 1, "cannot be reached", (one,), {"AWS_ENDPOINT_URL": "http://127.0.0.1:1"}),
    ]
    for what, expected, words, given, environment in cases:
        code, out, told = store.score(*given, **environment)
        check(code == expected and words in told, f"{what}: exit code {code}, {told}")
        check(out == "", f"{what}: {out}")
    listing = f"few/{recordings[0].name}\nfew/gone.mcap\n"
    store.client.put_object(Bucket=BUCKET, Key="short.txt", Body=listing.encode())
    code, out, told = store.score("--manifest", f"s3://{BUCKET}/short.txt", "--csv", "-")
    check(code == 3 and [r["problem"] for r in table(out)] == ["", "no such object"], f"{out} {told}")
    code, out, told = store.score(f"s3://{BUCKET}/few/", "--json")
    check(code == 0 and len(out.splitlines()) == 5 and '"file":"s3://' in out, f"JSON: {out} {told}")
    print(f"{len(cases)} refusals, each by name and with its exit code")


def main():
    vitreo, folder = sys.argv[1:]
    recordings = sorted(Path(folder).glob("*.mcap"))
    check(recordings, f"no recordings in {folder}")
    store = Store(vitreo)
    text = killed_workers(store, recordings)
    as_on_disk(store, recordings, text)
    lost_and_cut(store, text)
    vanished_and_refused(store, recordings)
    refusals(store, recordings)
    store.server.stop()
    print("5 passed, 0 failed")


if __name__ == "__main__":
    main()
