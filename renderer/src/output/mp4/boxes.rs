//! The boxes of a fragmented MP4 with one track of H.264 (ISO/IEC 14496-12 and -15).

use mp4_atom::{
    Avc1, Avcc, Codec, Colr, Compressor, Dinf, Dref, DrefEntry, Encode, FourCC, FragmentInfo, Ftyp, Hdlr,
    Mdat, Mdhd, Mdia, Mehd, Mfhd, Mfra, Mfro, Minf, Moof, Moov, Mvex, Mvhd, Stbl, Stsd, Tfdt, Tfhd, Tfra,
    Tkhd, Traf, Trak, Trex, Trun, TrunEntry, Url, Visual, Vmhd,
};

/// Ticks of the film's clock a second.
pub const TICKS_PER_S: u32 = 90_000;
/// Number of the only track.
const TRACK: u32 = 1;
/// Flags of a sample with which a player can begin: it depends on no other.
const BEGINS: u32 = 0x0200_0000;
/// Flags of one that builds on those before it.
const BUILDS_ON: u32 = 0x0101_0000;
/// Size of a box's head, bytes.
const BOX_HEAD: usize = 8;
/// What the standard calls BT.709 for primaries, transfer and matrix.
const BT709: u16 = 1;

/// A picture in a fragment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sample {
    /// Bytes of its units.
    pub bytes: u32,
    /// A player can begin with it.
    pub begins: bool,
}

/// Bytes of a box.
fn bytes_of(atom: &impl Encode) -> Vec<u8> {
    let mut bytes = Vec::new();
    atom.encode(&mut bytes).expect("memory, and numbers that fit");
    bytes
}

/// The beginning of a file: what it is, its size and the parameter sets of sequence and picture.
/// `length` in ticks, 0 while it is not known.
pub fn head(size_px: [u32; 2], [sequence, picture]: &[Vec<u8>; 2], length: u64) -> Vec<u8> {
    let brands = [b"iso5", b"iso6", b"avc1", b"mp41"].map(FourCC::new).to_vec();
    let kind = Ftyp { major_brand: FourCC::new(b"iso5"), minor_version: 512, compatible_brands: brands };
    let mvhd = Mvhd {
        timescale: TICKS_PER_S,
        rate: 1.into(),
        volume: 1.into(),
        next_track_id: TRACK + 1,
        ..Mvhd::default()
    };
    let trex = Trex { track_id: TRACK, default_sample_description_index: 1, ..Trex::default() };
    let mvex = Mvex { mehd: Some(Mehd { fragment_duration: length }), trex: vec![trex] };
    let trak = track(size_px.map(|n| n as u16), Avcc::new(sequence, picture));
    let moov = Moov { mvhd, mvex: Some(mvex), trak: vec![trak], ..Moov::default() };
    [bytes_of(&kind), bytes_of(&moov)].concat()
}

/// The track: its size and its codec.
fn track([width, height]: [u16; 2], avcc: mp4_atom::Result<Avcc>) -> Trak {
    let visual = Visual {
        data_reference_index: 1,
        width,
        height,
        compressor: Compressor::from("OpenH264"),
        ..Visual::default()
    };
    let colr = Colr::Nclx {
        colour_primaries: BT709,
        transfer_characteristics: BT709,
        matrix_coefficients: BT709,
        full_range_flag: false,
    };
    let avcc = avcc.expect("parameter sets of an encoder");
    let avc1 = Avc1 { visual, avcc, colr: Some(colr), ..Avc1::default() };
    let minf = Minf {
        vmhd: Some(Vmhd::default()),
        dinf: Dinf { dref: Dref { entries: vec![DrefEntry::Url(Url::default())] } },
        stbl: Stbl { stsd: Stsd { codecs: vec![Codec::Avc1(avc1)] }, ..Stbl::default() },
        ..Minf::default()
    };
    let mdia = Mdia {
        mdhd: Mdhd { timescale: TICKS_PER_S, language: "und".into(), ..Mdhd::default() },
        hdlr: Hdlr { handler: FourCC::new(b"vide"), name: "vitreo".into() },
        minf,
    };
    let (enabled, in_movie) = (true, true);
    let (width, height) = (width.into(), height.into());
    let tkhd = Tkhd { track_id: TRACK, enabled, in_movie, width, height, ..Tkhd::default() };
    Trak { tkhd, mdia, ..Trak::default() }
}

/// Fragment `number`, from 1 on, that begins at `time`: pictures of `ticks` each, whose units lie one
/// after the other.
pub fn fragment(number: u32, time: u64, ticks: u32, samples: &[Sample], units: &[u8]) -> Vec<u8> {
    let entries = samples.iter().map(|sample| TrunEntry {
        size: Some(sample.bytes),
        flags: Some(if sample.begins { BEGINS } else { BUILDS_ON }),
        ..TrunEntry::default()
    });
    let mut run = Trun { data_offset: Some(0), samples: entries.collect::<Vec<_>>().into() };
    let mut moof = |data_offset| {
        run.data_offset = Some(data_offset);
        let tfhd = Tfhd {
            track_id: TRACK,
            default_sample_duration: Some(ticks),
            default_base_is_moof: true,
            ..Tfhd::default()
        };
        let tfdt = Some(Tfdt { base_media_decode_time: time });
        let traf = Traf { tfhd, tfdt, trun: vec![run.clone()], ..Traf::default() };
        bytes_of(&Moof { mfhd: Mfhd { sequence_number: number }, traf: vec![traf] })
    };
    let before = moof(0).len() + BOX_HEAD;
    [moof(before as i32), bytes_of(&Mdat { data: units.to_vec() })].concat()
}

/// Where a player can begin: times and places of fragments.
pub fn index(fragments: &[(u64, u64)]) -> Vec<u8> {
    let entries = fragments.iter().map(|&(time, moof_offset)| FragmentInfo {
        time,
        moof_offset,
        traf_number: 1,
        trun_number: 1,
        sample_delta: 1,
    });
    let tfra = vec![Tfra { track_id: TRACK, entries: entries.collect() }];
    let mut mfra = Mfra { tfra, mfro: Mfro::default() };
    mfra.mfro.parent_size = bytes_of(&mfra).len() as u32;
    bytes_of(&mfra)
}
