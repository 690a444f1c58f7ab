//! Shards as they come from machines that were killed, lost a file, or had another list.

use super::*;
use crate::batch::Row;
use crate::parquet_file::write;
use crate::table::Keys;
use proptest::prelude::*;
use std::fs::File;
use std::io::{Seek, Write};
use std::path::PathBuf;

fn names(listed: u64) -> Vec<String> {
    (0..listed).map(|i| format!("{i}.mcap")).collect()
}

fn table_of(names: &[String]) -> Table {
    let row = |name: &String| Row {
        file: PathBuf::from(name),
        problem: name.starts_with('7').then(|| "torn".into()),
        seconds: 2.0,
        sha256: Some(format!("hash of {}", &name[..1])),
        ..Row::default()
    };
    Table::of_batch(&names.iter().map(row).collect::<Vec<_>>(), &Keys::default())
}

fn origin(shard: Shard, listed: u64) -> Origin {
    let names = names(listed);
    Origin {
        shard,
        listed,
        list_sha256: digest(names.iter().map(String::as_str)),
        made: "vitreo 1, score 4".into(),
    }
}

/// The file of a shard.
fn bytes(shard: Shard, listed: u64) -> Vec<u8> {
    let (origin, table) = (origin(shard, listed), table_of(&shard.of(&names(listed))));
    bytes_of(&origin, &table)
}

fn bytes_of(origin: &Origin, table: &Table) -> Vec<u8> {
    let (mut bytes, notes) = (Vec::new(), origin.notes(table));
    let notes: Vec<(&str, &str)> = notes.iter().map(|(key, value)| (*key, value.as_str())).collect();
    write(table, &mut bytes, &notes).unwrap();
    bytes
}

fn file_of(bytes: &[u8]) -> File {
    let mut file = tempfile::tempfile().unwrap();
    file.write_all(bytes).unwrap();
    file.rewind().unwrap();
    file
}

fn found(count: u32, listed: u64) -> Vec<(Shard, Result<ShardTable, ShardError>)> {
    let shards = (0..count).map(|index| Shard { index, count });
    shards.map(|shard| (shard, read(file_of(&bytes(shard, listed))))).collect()
}

fn told(found: Vec<(Shard, Result<ShardTable, ShardError>)>) -> String {
    gather(found).unwrap_err().to_string()
}

proptest! {
    #[test]
    fn all_shards_are_the_list_again(count in 1u32..7, listed in 0u64..40, turn in 0usize..7) {
        let mut found = found(count, listed);
        found.rotate_left(turn % count as usize);
        let whole = gather(found).unwrap();
        prop_assert_eq!(whole.table, table_of(&names(listed)));
        prop_assert_eq!(whole.origin, origin(Shard::WHOLE, listed));
    }

    #[test]
    fn a_shard_that_is_lost_or_cut_is_told_by_name(count in 2u32..7, which in 0usize..7, share in 0.0f64..1.0) {
        let (which, listed) = (which % count as usize, 30);
        let mut lost = found(count, listed);
        let (shard, _) = lost.remove(which);
        prop_assert_eq!(told(lost), format!("{}: missing", shard.file_name()));
        let mut cut = found(count, listed);
        let whole = bytes(shard, listed);
        cut[which].1 = read(file_of(&whole[..(whole.len() as f64 * share) as usize]));
        let told = told(cut);
        prop_assert!(told.starts_with(&format!("{}: truncated or damaged: ", shard.file_name())), "{}", told);
        prop_assert_eq!(told.lines().count(), 1);
    }

    #[test]
    fn a_changed_byte_changes_no_row_unseen(at in 0.0f64..1.0, flip in 1u8..=255) {
        let shard = Shard { index: 1, count: 3 };
        let mut bytes = bytes(shard, 30);
        let place = (bytes.len() as f64 * at) as usize;
        bytes[place] ^= flip;
        if let Ok(read) = read(file_of(&bytes)) {
            prop_assert_eq!(read.table, table_of(&shard.of(&names(30))));
        }
    }
}

#[test]
fn what_is_no_shard_or_of_another_batch_is_told() {
    assert!(told(Vec::new()).contains("found none"));
    let mut mixed = found(3, 9);
    mixed.extend(found(2, 9));
    assert!(told(mixed).contains("2 of 2 shards, 3 of 3 shards"));
    let mut swapped = found(3, 9);
    swapped[1].1 = read(file_of(&bytes(Shard { index: 2, count: 3 }, 9)));
    assert!(told(swapped).contains("scores-00001-of-00003.parquet: is the table of shard 2/3"));
    let mut other = found(3, 9);
    other[2].1 = read(file_of(&bytes(Shard { index: 2, count: 3 }, 10)));
    assert!(told(other).contains("scores-00002-of-00003.parquet: another list (10 recordings, not 9)"));
    let mut bare = Vec::new();
    write(&table_of(&names(3)), &mut bare, &[]).unwrap();
    assert!(read(file_of(&bare)).unwrap_err().to_string().contains("found no 'shard'"));
    let short = bytes_of(&origin(Shard { index: 0, count: 3 }, 9), &table_of(&names(2)));
    assert!(read(file_of(&short)).unwrap_err().to_string().contains("expected 3 rows"));
    let far = Shard { index: 4_000_000_000, count: u32::MAX };
    assert!(told(vec![(far, Err(ShardError::Changed))]).contains("and 4294967194 more"));
}

#[test]
fn a_list_that_was_told_wrong_is_seen() {
    let shard = Shard::WHOLE;
    let wrong =
        bytes_of(&origin(shard, 4), &table_of(&["0.mcap", "1.mcap", "1.mcap", "3.mcap"].map(String::from)));
    assert!(told(vec![(shard, read(file_of(&wrong)))]).contains("not those of their list"));
}

#[test]
fn equal_content_under_two_names_is_told_across_shards() {
    let whole = gather(found(4, 12)).unwrap().table;
    let same: Vec<_> = whole.texts("same_as").iter().map(Option::as_deref).collect();
    assert_eq!(same[..10], [None; 10]);
    assert_eq!(same[10..], [Some("1.mcap"); 2], "10.mcap and 11.mcap have the hash of 1.mcap");
}
