//! What a schema refuses: at which number, and in which words.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use flight_core::BuildError;
use flight_io::{Schema, from_json, from_value, hold, load_by, load_changed, resolve_table, set_keys};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// A table with every kind of limit.
#[derive(Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Limits {
    #[schemars(range(min = 1, max = 3))]
    closed: f64,
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 2))]
    open: f64,
    free: f64,
    count: u64,
    #[schemars(length(min = 1, max = 2), inner(range(min = 0)))]
    list: Vec<f64>,
    three: [f64; 3],
    optional: Option<f64>,
    text: String,
    flag: bool,
    by_name: BTreeMap<String, Limits>,
    kind: Option<Kind>,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            closed: 1.0,
            open: 1.0,
            free: 0.0,
            count: 0,
            list: vec![0.0],
            three: [0.0; 3],
            optional: None,
            text: String::new(),
            flag: false,
            by_name: BTreeMap::new(),
            kind: None,
        }
    }
}

#[derive(Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum Kind {
    Round { radius: f64 },
    Flat {},
}

fn refusal(value: Value) -> Option<String> {
    from_value::<Limits>(value, "here").err().map(|error| error.to_string())
}

/// The ends of a range belong to it or not, as the schema says, and no number is beyond 10⁹.
#[test]
fn ends_of_ranges() {
    for accepted in [
        json!({"closed": 1}),
        json!({"closed": 3.0}),
        json!({"open": 1e-300}),
        json!({"open": 1.999}),
        json!({"free": 1e9}),
        json!({"free": -1e9}),
        json!({"count": 0}),
        json!({"count": 5_000_000_000_u64}),
        json!({"list": [0.0]}),
        json!({"list": [0.0, 1.0]}),
        json!({"by_name": {"any": {"closed": 2.0}}}),
        json!({"kind": {"kind": "flat"}}),
    ] {
        assert_eq!(refusal(accepted.clone()), None, "{accepted}");
    }
    for (refused, words) in [
        (json!({"closed": 0.999}), "here: `closed` is 0.999; expected a number ≥ 1 and ≤ 3"),
        (json!({"closed": 3.001}), "here: `closed` is 3.001; expected a number ≥ 1 and ≤ 3"),
        (json!({"open": 0.0}), "here: `open` is 0.0; expected a number > 0 and < 2"),
        (json!({"open": 2.0}), "here: `open` is 2.0; expected a number > 0 and < 2"),
        (json!({"free": 1.000_000_1e9}), "here: `free` is 1000000100.0; expected a number from -1e9 to 1e9"),
        (
            json!({"free": -1.000_000_1e9}),
            "here: `free` is -1000000100.0; expected a number from -1e9 to 1e9",
        ),
        (json!({"count": -1}), "here: `count` is -1; expected an integer ≥ 0"),
        (json!({"count": 1.5}), "here: `count` is 1.5; expected an integer ≥ 0"),
        (json!({"list": []}), "here: `list` is []; expected a list of 1 to 2"),
        (json!({"list": [1, 2, 3]}), "here: `list` is [1,2,3]; expected a list of 1 to 2"),
        (json!({"list": [1, -2]}), "here: `list[1]` is -2; expected a number ≥ 0"),
        (json!({"three": [1, 2]}), "here: `three` is [1,2]; expected a list of 3"),
        (json!({"three": [1, 2, "x"]}), "here: `three[2]` is \"x\"; expected a number"),
        (json!({"optional": "x"}), "here: `optional` is \"x\"; expected a number"),
        (json!({"text": 1}), "here: `text` is 1; expected a text"),
        (json!({"flag": 1}), "here: `flag` is 1; expected true or false"),
        (json!({"by_name": 1}), "here: `by_name` is 1; expected a table"),
        (
            json!({"by_name": {"any": {"open": 0}}}),
            "here: `by_name.any.open` is 0; expected a number > 0 and < 2",
        ),
        (json!({"kind": 1}), "here: `kind` is 1; expected a table"),
        (json!({"kind": {}}), "here: `kind.kind` is missing"),
        (json!({"kind": {"kind": "square"}}), "here: `kind.kind` is \"square\"; expected one of round, flat"),
        (json!({"kind": {"kind": "round"}}), "here: `kind.radius` is missing"),
        (json!({"kind": {"kind": "flat", "radius": 1}}), "here: unknown key `kind.radius` (known: kind)"),
        (json!(1), "here: the whole is 1; expected a table"),
    ] {
        assert_eq!(refusal(refused).as_deref(), Some(words));
    }
}

/// A key that is nearly right is suggested, one that is not is none; a long value is cut after 79 characters.
#[test]
fn refusals_are_short_and_helpful() {
    let unknown = |key: &str| refusal(json!({ key: 1 })).unwrap();
    assert!(
        unknown("optinal")
            .starts_with("here: unknown key `optinal`; did you mean `optional`? (known: by_name, closed")
    );
    assert!(unknown("weather").starts_with("here: unknown key `weather` (known: "));
    let shown = |length: usize| refusal(json!({"flag": "é".repeat(length)})).unwrap();
    assert_eq!(shown(78), format!("here: `flag` is \"{}\"; expected true or false", "é".repeat(78)));
    assert_eq!(shown(79), format!("here: `flag` is \"{}…; expected true or false", "é".repeat(78)));
}

/// A program reads file, key, value, expectation and suggestions, whatever the text of an error says.
#[test]
fn errors_have_parts() {
    let parts = |value: Value| from_value::<Limits>(value, "here").unwrap_err().parts();
    let some = |text: &str| Some(text.to_owned());
    let found = parts(json!({"by_name": {"any": {"list": [1, -2]}}}));
    assert_eq!((found.file, found.key), (some("here"), some("by_name.any.list[1]")));
    assert_eq!((found.value, found.expected), (some("-2"), some("a number ≥ 0")));
    let found = parts(json!({"by_name": {"any": {"optinal": 1}}}));
    assert_eq!((found.key, found.value), (some("by_name.any.optinal"), None));
    assert_eq!(found.suggestions, ["by_name.any.optional"]);
    assert!(found.expected.unwrap().starts_with("one of by_name, closed"));
    assert_eq!(parts(json!({"kind": {}})).key, some("kind.kind"));
}

mod another {
    #[derive(serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
    pub struct Limits {
        pub other: f64,
    }
}

/// A schema is derived once for a type, of which another may have the name.
#[test]
fn types_of_one_name_have_schemas_of_their_own() {
    for _ in 0..2 {
        let (ours, theirs) = (Schema::of_type::<Limits>(), Schema::of_type::<another::Limits>());
        assert!(ours.root().has("open") && !ours.root().has("other"));
        assert!(theirs.root().has("other") && !theirs.root().has("open"));
    }
}

/// Dotted keys are set under the rules of files; a part of a key that is no table is refused.
#[test]
fn keys_are_set_in_a_table() {
    let set = |key: &str, value: Value| {
        let table = json!({"list": [1, 2], "by_name": {"any": {"closed": 1}}, "optional": 1.0});
        let schema = Schema::of_type::<Limits>();
        set_keys(table, [(key.to_owned(), value)], Path::new(""), &schema)
    };
    assert_eq!(set("list.1", json!(5)).unwrap()["list"], json!([1, 5]));
    assert_eq!(set("by_name.new.closed", json!(2)).unwrap()["by_name"]["new"], json!({"closed": 2}));
    assert_eq!(set("optional", json!(false)).unwrap().get("optional"), None);
    assert_eq!(set("flag", json!(false)).unwrap()["flag"], json!(false));
    for (key, place) in
        [("optional.x", "optional"), ("list.2", "list"), ("list.x", "list"), ("list.0.x", "list.0")]
    {
        assert_eq!(set(key, json!(1)).unwrap_err().parts().key.as_deref(), Some(place));
    }
}

/// A file with changed keys: the file or the changes are blamed, as they are wrong.
#[test]
fn changes_of_a_file() {
    hold(Path::new("limits.toml"), b"closed = 2\nopen = 1\n".to_vec());
    hold(Path::new("wrong.toml"), b"closed = 9\n".to_vec());
    let load = |file: &str, changes: &[(&str, Value)]| {
        let changes: Vec<_> = changes.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        load_changed(Path::new(file), None, &changes, |limits: &Limits| {
            if limits.open < limits.closed {
                Ok(())
            } else {
                Err(BuildError::bad_value("open", limits.open, "less"))
            }
        })
        .map_err(|error| error.to_string())
    };
    let three = Limits { closed: 3.0, ..Limits::default() };
    for file in ["limits.toml", "wrong.toml"] {
        assert_eq!(load(file, &[("closed", json!(3))]).unwrap(), three);
    }
    for (file, key, value, expected) in [
        ("wrong.toml", "free", 1, "wrong.toml: `closed` is 9; expected a number ≥ 1 and ≤ 3"),
        ("limits.toml", "closed", 9, "`closed` is 9; expected a number ≥ 1 and ≤ 3"),
        ("limits.toml", "closed", 1, "cannot set `closed` = 1: open is 1; expected less"),
        ("limits.toml", "optinal", 1, "unknown key `optinal`; did you mean `optional`? (known: "),
        ("limits.toml", "x.closed", 1, "unknown key `x.closed`; did you mean `closed`? (known: "),
    ] {
        let message = load(file, &[(key, json!(value))]).unwrap_err();
        assert!(message.starts_with(expected), "{message}");
        // Another change, before or after it, is not to blame.
        for changes in
            [[("optional", json!(1)), (key, json!(value))], [(key, json!(value)), ("optional", json!(1))]]
        {
            let message = load(file, &changes).unwrap_err();
            assert!(message.starts_with(expected), "{message}");
        }
    }
}

/// What is no JSON is refused where it stands.
#[test]
fn a_text_that_is_no_json_is_refused() {
    let message = from_json::<Limits>("{\"closed\": }", "here").unwrap_err().to_string();
    assert!(message.starts_with("here: ") && message.contains("line 1 column 12"), "{message}");
    assert_eq!(from_json::<Limits>("{}", "here").unwrap(), Limits::default());
}

/// What the types of other programs have: alternatives of a value, tuples, tables of any keys, lists of files, a key
/// `base` of their own.
#[test]
fn a_schema_of_another_program() {
    let schema = Schema::of_json(json!({
        "$ref": "#/$defs/All",
        "$defs": {"All": {"type": "object", "additionalProperties": false, "properties": {
            "label": {"anyOf": [{"type": "string"}, {"type": "number", "minimum": 0.0}]},
            "pair": {
                "type": "array", "minItems": 2, "maxItems": 2, "items": false,
                "prefixItems": [{"type": "number"}, {"type": "number"}],
            },
            "set": {"type": "object"},
            "base": {"anyOf": [{"type": "string"}, {"type": "null"}]},
            "files": {"type": "array", "items": {"type": "string", "format": "path"}},
        }}},
    }));
    hold(Path::new("listed/a.toml"), b"label = 1\nbase = \"b\"\nset = { x = [1, \"y\"] }".to_vec());
    let load = |key: &str, value: Value| {
        load_by(Path::new("listed/a.toml"), &[(key.to_owned(), value)], &schema)
            .map_err(|error| error.to_string())
    };
    let loaded = load("pair", json!([0, 1])).unwrap();
    assert_eq!(loaded, json!({"label": 1, "base": "b", "set": {"x": [1, "y"]}, "pair": [0, 1]}));
    assert_eq!(load("base", json!(false)).unwrap().get("base"), None);
    let resolved = resolve_table(
        json!({"files": ["a.toml"]}).as_object().unwrap().clone(),
        Path::new("listed"),
        &schema,
    );
    assert_eq!(resolved.unwrap(), json!({"files": ["listed/a.toml"]}));
    for (key, value, expected) in [
        ("label", json!([]), "`label` is []; expected a number ≥ 0"),
        ("label", json!(-1), "`label` is -1; expected a number ≥ 0"),
        ("pair", json!([1]), "`pair` is [1]; expected a list of 2"),
        ("pair", json!([1, "x"]), "`pair[1]` is \"x\"; expected a number"),
        ("set", json!(1), "`set` is 1; expected a table"),
        ("sets", json!(1), "unknown key `sets`"),
    ] {
        let message = load(key, value).unwrap_err();
        assert!(message.contains(expected), "{message}");
    }
}
