//! Which files are read, and which tables and networks they make. Files are held in memory, each test under a folder of its
//! own.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::common::network::{card, paper, random_weights};
use crate::common::{assert_says, robot};
use flight_core::aero::Precision;
use flight_core::{BuildError, RobotModel};
use flight_io::network::load_network;
use flight_io::{
    AeroConfig, NetworkConfig, Schema, hold, load_changed, read_bytes, read_text, resolve, resolve_table,
};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;

fn hold_text(path: &str, text: &str) {
    hold(Path::new(path), text.as_bytes().to_vec());
}

/// A held file is found under every way to write its path; one that is not is looked for on the disk.
#[test]
fn paths_of_held_files() {
    hold_text("held/./a/../b.txt", "b");
    for path in ["held/b.txt", "./held/b.txt", "held/c/d/../../b.txt"] {
        assert_eq!(read_text(Path::new(path)).unwrap(), "b", "{path}");
    }
    hold_text("../above.txt", "above");
    assert_eq!(read_text(Path::new("x/../../above.txt")).unwrap(), "above");
    for path in ["above.txt", "../held/b.txt"] {
        assert_says(&read_text(Path::new(path)).unwrap_err(), &["cannot read", path]);
    }
    hold(Path::new("held/latin.txt"), vec![0xe9]);
    assert_says(&read_text(Path::new("held/latin.txt")).unwrap_err(), &["held/latin.txt: ", "utf-8"]);
    let marked = |bytes: fn(u16) -> [u8; 2]| "\u{feff}größe = 1".encode_utf16().flat_map(bytes).collect();
    for (name, bytes) in [("little", marked(u16::to_le_bytes)), ("big", marked(u16::to_be_bytes))] {
        let path = format!("held/{name}.toml");
        hold(Path::new(&path), bytes);
        assert_eq!(read_text(Path::new(&path)).unwrap(), "größe = 1", "{name}");
    }
    hold(Path::new("held/half.toml"), vec![0xff, 0xfe, 0x00, 0xd8]); // half of a pair
    assert_says(&read_text(Path::new("held/half.toml")).unwrap_err(), &["held/half.toml: ", "utf-16"]);
    assert_says(
        &read_bytes(Path::new(".")).unwrap_err(),
        &["expected a regular file of at most 67108864 bytes"],
    );
}

/// A path becomes text in a resolved configuration, where bytes of another encoding would lead nowhere.
#[cfg(unix)]
#[test]
fn paths_that_are_no_text() {
    use std::os::unix::ffi::OsStrExt;
    for name in [&b"gr\xf6\xdfe/a.toml"[..], b"\xff", b"caf\xe9/sub/a.toml"] {
        let path = Path::new(std::ffi::OsStr::from_bytes(name));
        let shown = path.display().to_string();
        assert_says(&read_text(path).unwrap_err(), &[&shown, "is not UTF-8; expected"]);
    }
    assert_says(&read_text(Path::new("größe/a.toml")).unwrap_err(), &["cannot read", "größe/a.toml"]);
}

/// A file anywhere reads as if it stood among the shipped ones: their names and paths lead to them, unless its own do.
#[test]
fn files_beside_the_shipped_ones() {
    hold_text(
        "shipped/aero/base.toml",
        "model = 'network'\nair_density = 1.2\ncard = '../cards/shipped.json'\n",
    );
    hold_text("shipped/cards/shipped.json", "{}");
    let shipped = Path::new("shipped/aero");
    let load = |text: &str, changes: &[(String, Value)]| {
        hold_text("own/own.toml", text);
        load_changed(Path::new("own/own.toml"), Some(shipped), changes, |_: &AeroConfig| Ok(()))
    };
    let card_of = |text: &str| {
        let AeroConfig::Network(NetworkConfig { card, .. }) = load(text, &[]).unwrap() else {
            unreachable!()
        };
        card
    };
    let of_shipped = Path::new("shipped/cards/shipped.json");
    for text in [
        "base = 'base'",
        "base = 'base.toml'",
        "model = 'network'\nair_density = 1.2\ncard = '../cards/shipped.json'",
    ] {
        assert_eq!(card_of(text), of_shipped, "{text}");
    }
    hold_text("own/base.toml", "model = 'network'\nair_density = 1.2\ncard = 'card.json'\n");
    hold_text("own/card.json", "{}");
    assert_eq!(card_of("base = 'base'"), Path::new("own/card.json"));
    let expected = "expected the path of a file that exists; there is no own/esab.toml in the current folder, and no \
                    shipped/aero/esab.toml in the current folder";
    assert_says(&load("base = 'esab'", &[]).unwrap_err(), &[&format!("`base` is \"esab.toml\"; {expected}")]);
    let changes = [("card".to_owned(), json!("absent.json"))];
    assert_says(
        &load("base = 'base'", &changes).unwrap_err(),
        &["`card` is \"absent.json\"; expected the path of a file that exists; there is no absent.json in \
          the current folder"],
    );
}

/// The JSON of a text has its keys in the order of the text, in every table, and is otherwise that of its table.
#[test]
fn order_of_keys() {
    let text = "z = 1.5\na = [{ y = 'é', b = -0.0 }, [true]]\n[m]\nq.w = 1e-300\nd = 2\nq.c = 3\n[[k]]\nx = 1\n[[k]]\ny = []\n";
    let expected = "{\"z\":1.5,\"a\":[{\"y\":\"é\",\"b\":-0.0},[true]],\"m\":{\"q\":{\"w\":1e-300,\"c\":3},\"d\":2},\
                    \"k\":[{\"x\":1},{\"y\":[]}]}";
    let json = flight_io::toml::to_json(text, "here").unwrap();
    assert_eq!(json, expected);
    let table = flight_io::toml::parse(text, "here").unwrap();
    assert_eq!(serde_json::from_str::<Value>(&json).unwrap(), Value::Object(table));
    let error = flight_io::toml::to_json("a = 1979-05-27", "here").unwrap_err();
    assert_says(&error, &["here: `a` is 1979-05-27; expected a number, text, list or table"]);
}

/// An error of the parser is one line with its place, however long that of the file is.
#[test]
fn errors_of_the_parser() {
    for (text, place) in [
        ("title", "line 1, column 6: key with no value, expected `=`"),
        (&format!("é = 1\né = = {}", "2".repeat(10_000)), "line 2, column 5: "),
        (&format!("a = {}", "[".repeat(100)), "line 1, column 8"),
    ] {
        let message = flight_io::toml::parse(text, "own.toml").unwrap_err().to_string();
        assert!(message.starts_with(&format!("own.toml: no TOML at {place}")), "{message}");
        assert!(message.len() < 150 && !message.contains('\n'), "{message}");
    }
}

/// A configuration of 256 files is read, one of 257 is not; the same for a table that is no file.
#[test]
fn number_of_base_files() {
    hold_text("many/leaf.toml", "x = 1\n");
    let tables = |count: usize| {
        (0..count).fold(String::new(), |mut text, table| {
            writeln!(text, "t{table} = {{ base = 'leaf.toml' }}").unwrap();
            text
        })
    };
    let read = |count: usize| {
        hold_text("many/top.toml", &tables(count));
        resolve(Path::new("many/top.toml"), &Schema::of_type::<AeroConfig>())
    };
    assert_eq!(read(255).unwrap().as_object().unwrap().len(), 255);
    assert_says(&read(256).unwrap_err(), &["many/leaf.toml: more than 256 `base` files are read"]);
    let table = |count: usize| {
        let table = flight_io::toml::parse(&tables(count), "here").unwrap();
        resolve_table(table, Path::new("many"), &Schema::of_type::<AeroConfig>())
    };
    assert!(table(256).is_ok());
    assert!(table(257).is_err());
}

/// Sixteen files may build on one another below a first.
#[test]
fn depth_of_base_files() {
    for file in 0..18 {
        hold_text(&format!("deep/{file}.toml"), &format!("base = '{}.toml'\n", file + 1));
    }
    hold_text("deep/18.toml", "x = 1\n");
    let read =
        |file: usize| resolve(Path::new(&format!("deep/{file}.toml")), &Schema::of_type::<AeroConfig>());
    assert_eq!(read(2).unwrap(), json!({"x": 1}));
    assert_says(&read(1).unwrap_err(), &["deep/18.toml", "more than 16 deep"]);
}

/// What TOML can say and a configuration cannot is refused by key.
#[test]
fn values_of_toml() {
    for (text, words) in [
        ("a = [{ b = inf }]", "here: `a[0].b` is inf; expected a finite number"),
        (
            "a.b = 2020-01-01",
            "here: `a.b` is 2020-01-01; expected a number, text, list or table, as no key is a date",
        ),
    ] {
        let found = flight_io::toml::parse(text, "here").unwrap_err().to_string();
        assert_eq!(found, words);
    }
}

/// A network of a robot whose weights file and card are spoilt.
fn network(
    robot: &RobotModel,
    name: &str,
    weights: &[u8],
    spoil: &[(&str, Value)],
) -> Result<(), BuildError> {
    let mut card = card(robot, &paper(&[4]), name, weights);
    for (pointer, value) in spoil {
        *card.pointer_mut(pointer).unwrap() = value.clone();
    }
    hold_text(&format!("networks/{name}.json"), &card.to_string());
    hold(Path::new(&format!("networks/{name}.safetensors")), weights.to_vec());
    let config = NetworkConfig {
        card: format!("networks/{name}.json").into(),
        precision: Precision::F64,
        air_density: 1.225,
    };
    load_network(&config, robot).map(|_| ())
}

/// The table of a safetensors file changed, and bytes added at its end.
fn with_table(file: &[u8], change: impl FnOnce(&mut Value), more: &[u8]) -> Vec<u8> {
    let (length, rest) = file.split_first_chunk::<8>().unwrap();
    let (table, data) = rest.split_at(usize::try_from(u64::from_le_bytes(*length)).unwrap());
    let mut table: Value = serde_json::from_slice(table).unwrap();
    change(&mut table);
    let table = table.to_string();
    [&(table.len() as u64).to_le_bytes(), table.as_bytes(), data, more].concat()
}

/// Tensors fill the file, one after the other, each as large as its shape says.
#[test]
fn tensors_fill_their_file() {
    let robot = robot("sparrow");
    let sound = random_weights(&robot, &paper(&[4]));
    let offsets = |table: &mut Value, tensor: &str, by: [i64; 2]| {
        for (offset, by) in table[tensor]["data_offsets"].as_array_mut().unwrap().iter_mut().zip(by) {
            *offset = json!(offset.as_i64().unwrap() + by);
        }
    };
    let changed = |change: &dyn Fn(&mut Value)| with_table(&sound, change, &[]);
    let offset = "output.offset";
    network(&robot, "sound", &sound, &[]).unwrap();
    let noted = changed(&|table| table["__metadata__"] = json!({"of": "a test"}));
    network(&robot, "noted", &noted, &[]).unwrap();
    let announced = |length: u64| [&length.to_le_bytes(), &sound[8..]].concat();
    for (name, file, words) in [
        ("short", sound[..7].to_vec(), &["7 bytes are no safetensors file"][..]),
        ("long", announced(sound.len() as u64 - 7), &["announces a table of", "the file is shorter"]),
        ("whole", announced(sound.len() as u64 - 8), &["its table: "]),
        ("more", with_table(&sound, |_| {}, &[0; 4]), &["tensors end at byte"]),
        (
            "gap",
            changed(&|table| offsets(table, offset, [4, 0])),
            &["`output.offset` fills bytes", "to begin at"],
        ),
        ("overlap", changed(&|table| offsets(table, offset, [-4, 0])), &["`output.offset` fills bytes"]),
        (
            "beyond",
            changed(&|table| offsets(table, offset, [0, 4])),
            &["`output.offset` fills", "to end within"],
        ),
        (
            "type",
            changed(&|table| table[offset]["dtype"] = json!("F64")),
            &["dtype of tensor `output.offset`", "F64"],
        ),
        (
            "shape",
            changed(&|table| table[offset]["shape"] = json!([1, 2])),
            &["bytes of tensor `output.offset`", "is 48; expected 8 for the shape [1, 2]"],
        ),
        (
            "huge",
            changed(&|table| table[offset]["shape"] = json!([u64::MAX, 2])),
            &["bytes of tensor `output.offset`"],
        ),
        (
            "key",
            changed(&|table| table[offset]["x"] = json!(1)),
            &["tensor `output.offset`: unknown field `x`"],
        ),
    ] {
        assert_says(&network(&robot, name, &file, &[]).unwrap_err(), words);
    }
}

/// A card is of this format and version, and its weights lie beside it and are those that it was written for.
#[test]
fn cards_are_of_their_weights() {
    let robot = robot("sparrow");
    let weights = random_weights(&robot, &paper(&[4]));
    for (pointer, value, words) in [
        (
            "/format",
            json!("other"),
            &["networks/card.json: `format` is other; expected flight-aero-network"][..],
        ),
        ("/version", json!(2), &["networks/card.json: `version` is 2; expected 1"]),
        ("/weights/file", json!("../card.safetensors"), &["`weights.file`", "a name beside the card"]),
        ("/weights/file", json!(".."), &["`weights.file`", "a name beside the card"]),
        ("/weights/file", json!(""), &["`weights.file`", "a name beside the card"]),
        (
            "/weights/sha256",
            json!("00"),
            &["`weights.sha256` is 00; expected", "the hash of networks/card.safetensors"],
        ),
    ] {
        assert_says(&network(&robot, "card", &weights, &[(pointer, value)]).unwrap_err(), words);
    }
    let upper =
        card(&robot, &paper(&[4]), "upper", &weights)["weights"]["sha256"].as_str().unwrap().to_uppercase();
    network(&robot, "upper", &weights, &[("/weights/sha256", json!(upper))]).unwrap();
}
