//! Films are read back: boxes by mp4-atom, pictures by OpenH264's decoder.

use super::*;
use mp4_atom::{Any, Codec, Decode, Moof, Moov};
use openh264::decoder::Decoder;
use openh264::formats::YUVSource;
use outputs::Outputs;

const SIZE_PX: [u32; 2] = [192, 96];
const HZ: u32 = 25;

/// A bright ball on a dark ground with a gradient, moved on by `number`.
fn picture(number: u32) -> Picture {
    let [w, h] = SIZE_PX;
    let pixel = |i: u32| {
        let (x, y) = (i % w, i / w);
        let (dx, dy) = (x as i32 - 30 - 2 * number as i32, y as i32 - 48);
        let ball = dx * dx + dy * dy < 400;
        let [r, g, b] = if ball { [220, 150, 90] } else { [20 + (x / 4) as u8, 10 + (y / 8) as u8, 8] };
        [r, g, b, 255]
    };
    Picture { width_px: w, height_px: h, rgba: (0..w * h).flat_map(pixel).collect() }
}

/// Luma of a picture as it is encoded.
fn luma(picture: &Picture) -> Vec<u8> {
    let ([w, h], mut rgb, mut planes) = (SIZE_PX, Vec::new(), Vec::new());
    scale_rgb(picture, w, h, &mut rgb);
    to_planes(&rgb, w as usize, h as usize, &VIDEO, &mut planes);
    planes.truncate((w * h) as usize);
    planes
}

/// What a reader makes of a file: its head, fragments with their place, and the pictures' luma.
struct Read {
    moov: Moov,
    moofs: Vec<(u64, Moof)>,
    index: Option<mp4_atom::Mfra>,
    luma: Vec<Vec<u8>>,
}

fn read(bytes: &[u8]) -> Read {
    let (mut rest, mut moov, mut moofs, mut index) = (bytes, None, Vec::new(), None);
    let (mut decoder, mut luma) = (Decoder::new().unwrap(), Vec::new());
    while !rest.is_empty() {
        let at = (bytes.len() - rest.len()) as u64;
        // A fragment that was cut off ends the file.
        let Ok(atom) = Any::decode(&mut rest) else { break };
        match atom {
            Any::Moov(head) => {
                decode(&mut decoder, &parameter_sets(&head), &mut Vec::new());
                moov = Some(head);
            }
            Any::Moof(moof) => moofs.push((at, moof)),
            Any::Mdat(data) => {
                let (place, moof) = moofs.last().expect("a fragment's head");
                let run = &moof.traf[0].trun[0];
                assert_eq!(place + run.data_offset.unwrap() as u64, at + 8, "the data begin where it says");
                let mut data = &data.data[..];
                for sample in run.samples.iter() {
                    let (units, after) = data.split_at(sample.size.unwrap() as usize);
                    decode(&mut decoder, units, &mut luma);
                    data = after;
                }
                assert!(data.is_empty());
            }
            Any::Mfra(atom) => index = Some(atom),
            _ => {}
        }
    }
    Read { moov: moov.expect("a head"), moofs, index, luma }
}

/// The head's parameter sets as units behind their lengths.
fn parameter_sets(moov: &Moov) -> Vec<u8> {
    let Codec::Avc1(avc1) = &moov.trak[0].mdia.minf.stbl.stsd.codecs[0] else { panic!("no H.264") };
    let sets = avc1.avcc.sequence_parameter_sets.iter().chain(&avc1.avcc.picture_parameter_sets);
    sets.flat_map(|set| [&(set.len() as u32).to_be_bytes()[..], set].concat()).collect()
}

fn decode(decoder: &mut Decoder, mut units: &[u8], luma: &mut Vec<Vec<u8>>) {
    let mut coded = Vec::new();
    while let Some((length, rest)) = units.split_first_chunk::<4>() {
        let (unit, rest) = rest.split_at(u32::from_be_bytes(*length) as usize);
        coded.extend([START_CODE, unit].concat());
        units = rest;
    }
    if let Some(picture) = decoder.decode(&coded).unwrap() {
        let ((w, h), stride) = (picture.dimensions(), picture.strides().0);
        assert_eq!([w, h], SIZE_PX.map(|n| n as usize));
        luma.push(picture.y().chunks(stride).take(h).flat_map(|row| &row[..w]).copied().collect());
    }
}

/// Peak signal to noise ratio, dB.
fn psnr(a: &[u8], b: &[u8]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
    10.0 * (255.0f64.powi(2) * a.len() as f64 / squares.max(1e-9)).log10()
}

fn film(pictures: u32, ends: bool) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mp4");
    let mut film = Mp4::begin(Outputs::new(false).grow(&path).unwrap(), SIZE_PX, HZ).unwrap();
    assert!(!path.exists());
    (0..pictures).for_each(|n| film.write(&picture(n), 1).unwrap());
    if ends {
        film.finish().unwrap();
    }
    drop(film);
    std::fs::read(&path).unwrap()
}

#[test]
fn every_picture_comes_back_in_its_place() {
    let read = read(&film(60, true));
    assert_eq!(read.luma.len(), 60);
    for (number, seen) in read.luma.iter().enumerate() {
        let [same, other] = [0, 8].map(|off| psnr(seen, &luma(&picture(number as u32 + off))));
        assert!(same > 38.0 && other < 30.0, "picture {number}: {same:.1} dB, the eighth after: {other:.1}");
    }
    // Fragments of a second; a picture coded on its own every two seconds.
    let starts =
        read.moofs.iter().map(|(_, moof)| moof.traf[0].tfdt.as_ref().unwrap().base_media_decode_time);
    assert_eq!(starts.collect::<Vec<_>>(), [0, 90_000, 180_000]);
    let flags = read.moofs.iter().flat_map(|(_, moof)| moof.traf[0].trun[0].samples.iter());
    let begins = flags.map(|s| s.flags.unwrap() & 0x0001_0000 == 0).enumerate().filter(|(_, b)| *b);
    assert_eq!(begins.map(|(n, _)| n).collect::<Vec<_>>(), [0, 50]);
    assert_eq!(read.moov.mvex.unwrap().mehd.unwrap().fragment_duration, 60 * 3600);
    let index = &read.index.expect("an index").tfra[0].entries;
    let places = index.iter().map(|entry| (entry.time, entry.moof_offset)).collect::<Vec<_>>();
    assert_eq!(places, [(0, read.moofs[0].0), (180_000, read.moofs[2].0)]);
}

#[test]
fn a_film_that_was_not_closed_lacks_its_last_second_at_most() {
    let whole = film(60, false);
    assert_eq!(read(&whole).luma.len(), 50);
    let cut = read(&whole[..whole.len() - 7]);
    assert_eq!((cut.luma.len(), cut.index.is_none()), (25, true));
}

#[test]
fn a_picture_that_stands_is_written_as_often_as_it_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mp4");
    let mut film = Mp4::begin(Outputs::new(false).grow(&path).unwrap(), SIZE_PX, HZ).unwrap();
    film.write(&picture(3), 30).unwrap();
    // Of another size, as where the tier has changed.
    let small = Picture { width_px: 96, height_px: 48, rgba: vec![90; 96 * 48 * 4] };
    film.write(&small, 1).unwrap();
    film.finish().unwrap();
    let read = read(&std::fs::read(&path).unwrap());
    assert_eq!(read.luma.len(), 31);
    assert!(psnr(&read.luma[29], &luma(&picture(3))) > 38.0 && psnr(&read.luma[30], &luma(&small)) > 38.0);
}

#[test]
fn a_full_disk_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("full.mp4");
    std::os::unix::fs::symlink("/dev/full", &path).unwrap();
    let mut film = Mp4::begin(Outputs::new(false).grow(&path).unwrap(), SIZE_PX, HZ).unwrap();
    let told = film.write(&picture(0), 1).unwrap_err().to_string();
    assert!(told.contains("full.mp4") && told.contains("disk is full"), "{told}");
}
