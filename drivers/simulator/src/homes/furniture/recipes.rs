//! Furniture requested for each kind of room, most important first.

use super::place::Stand;
use super::workshop::{Piece, Workshop};
use crate::homes::texture::Skin;
use crate::homes::{HomeKind, Room, RoomKind};

/// A request for furniture: the first of its pieces that fits is placed.
pub struct Request {
    pub stand: Stand,
    pub pieces: Vec<Piece>,
}

fn request(stand: Stand, pieces: Vec<Piece>) -> Request {
    Request { stand, pieces }
}

/// All furniture requests for a room.
pub fn recipe(home: HomeKind, room: &Room, shop: &mut Workshop<'_>) -> Vec<Request> {
    let area = room.rect.area_m2();
    let mut requests = match room.kind {
        RoomKind::Living => living(area, shop),
        RoomKind::Kitchen => kitchen(area, shop),
        RoomKind::Bedroom => bedroom(area, shop),
        RoomKind::Bath => bath(home, area, shop),
        RoomKind::Study => study(home, area, shop),
        RoomKind::Corridor => corridor(room, shop),
        RoomKind::OpenPlan => open_plan(area, shop),
        RoomKind::Meeting => meeting(area, shop),
    };
    let things = match room.kind {
        RoomKind::Bath => 1,
        RoomKind::Corridor => 2,
        _ => 1 + (area / 7.0) as usize,
    };
    let children =
        home != HomeKind::Office && matches!(room.kind, RoomKind::Living | RoomKind::Bedroom);
    for _ in 0..things {
        if shop.chance(0.7) {
            requests.push(request(Stand::Wall, vec![shop.floor_thing(children)]));
        }
    }
    requests
}

fn living(area: f32, shop: &mut Workshop<'_>) -> Vec<Request> {
    let mut requests = Vec::new();
    let lounges =
        if area > 17.0 { vec![shop.lounge(3), shop.lounge(2)] } else { vec![shop.lounge(2)] };
    requests.push(request(Stand::Wall, lounges.into_iter().chain([shop.sofa(2)]).collect()));
    requests.push(request(Stand::Wall, vec![shop.television()]));
    if area > 22.0 {
        requests.push(request(
            Stand::Middle,
            vec![shop.dining_set(3, true), shop.dining_set(2, false)],
        ));
    } else if area > 15.0 {
        requests.push(request(
            Stand::Middle,
            vec![shop.dining_set(2, false), shop.dining_set(1, false)],
        ));
    }
    for _ in 0..1 + (area / 12.0) as usize {
        // Low furniture fits under windows.
        requests.push(request(Stand::Wall, vec![shop.bookshelf(), shop.chest(1.1, 3)]));
    }
    requests.push(request(Stand::Corner, vec![shop.sofa(1)]));
    requests.push(request(Stand::Corner, vec![shop.plant()]));
    requests.push(request(Stand::Corner, vec![shop.floor_lamp()]));
    if area > 20.0 {
        let width = shop.between(0.9, 1.3);
        requests.push(request(Stand::Wall, vec![shop.chest(width, 4)]));
        requests.push(request(Stand::Corner, vec![shop.plant()]));
    }
    requests
}

fn kitchen(area: f32, shop: &mut Workshop<'_>) -> Vec<Request> {
    let colors =
        [[242, 240, 236], [196, 152, 108], [128, 146, 140], [150, 162, 176], [214, 204, 186]];
    let index = (shop.between(0.0, 4.99)) as usize;
    let skin = if index == 1 { Skin::Grain } else { Skin::Smudge };
    let front = shop.materials.appearance("kitchen front", colors[index], skin);
    let mut counters = Vec::new();
    for units in [5, 4, 3] {
        counters.extend([shop.counter(units, true, front), shop.counter(units, false, front)]);
    }
    counters.push(shop.counter(2, false, front));
    let mut requests =
        vec![request(Stand::Wall, counters), request(Stand::Wall, vec![shop.fridge()])];
    if area > 9.0 {
        requests.push(request(
            Stand::Middle,
            vec![shop.dining_set(2, false), shop.dining_set(1, false)],
        ));
        requests.push(request(Stand::Wall, vec![shop.counter(2, false, front)]));
    } else {
        requests.push(request(Stand::Wall, vec![shop.dining_set(1, false)]));
    }
    requests.push(request(Stand::Corner, vec![shop.plant()]));
    requests
}

fn bedroom(area: f32, shop: &mut Workshop<'_>) -> Vec<Request> {
    let width = shop.between(1.4, 1.8);
    let beds = if area > 10.0 {
        vec![shop.bed(width), shop.bed(1.2)]
    } else {
        vec![shop.bed(1.2), shop.bed(0.95)]
    };
    let mut requests = vec![request(Stand::Wall, beds)];
    requests.push(request(
        Stand::Wall,
        vec![shop.wardrobe(1.8), shop.wardrobe(1.2), shop.wardrobe(0.8)],
    ));
    requests.push(request(Stand::Wall, vec![shop.nightstand()]));
    if area > 12.0 {
        let width = shop.between(0.8, 1.2);
        requests.push(request(Stand::Wall, vec![shop.chest(width, 4)]));
        requests.push(request(Stand::Wall, vec![shop.nightstand()]));
    }
    if area > 13.0 && shop.chance(0.5) {
        requests.push(request(Stand::Wall, vec![shop.desk()]));
    }
    requests.push(request(Stand::Wall, vec![shop.bookshelf(), shop.chest(0.9, 3)]));
    requests.push(request(Stand::Corner, vec![shop.plant()]));
    requests
}

fn bath(home: HomeKind, area: f32, shop: &mut Workshop<'_>) -> Vec<Request> {
    let mut requests = Vec::new();
    if home == HomeKind::Office {
        requests.push(request(Stand::Wall, vec![shop.toilet()]));
        requests.push(request(Stand::Wall, vec![shop.washstand()]));
        requests.push(request(Stand::Wall, vec![shop.wardrobe(1.2)]));
        requests.push(request(Stand::Corner, vec![shop.plant()]));
    } else {
        let wash = if area > 4.5 { vec![shop.tub(), shop.shower()] } else { vec![shop.shower()] };
        requests.push(request(Stand::Corner, wash));
    }
    requests.push(request(Stand::Wall, vec![shop.toilet()]));
    requests.push(request(Stand::Wall, vec![shop.washstand()]));
    if home != HomeKind::Office {
        requests.push(request(Stand::Wall, vec![shop.washer()]));
        if area > 7.0 {
            requests.push(request(Stand::Wall, vec![shop.chest(0.7, 4)]));
        }
    }
    requests
}

fn study(home: HomeKind, area: f32, shop: &mut Workshop<'_>) -> Vec<Request> {
    let mut requests = vec![request(Stand::Wall, vec![shop.desk()])];
    if home == HomeKind::Office && area > 11.0 {
        requests.push(request(Stand::Wall, vec![shop.desk()]));
        requests.push(request(Stand::Wall, vec![shop.filing_cabinet()]));
    }
    for _ in 0..1 + (area / 8.0) as usize {
        requests.push(request(Stand::Wall, vec![shop.bookshelf()]));
    }
    requests.push(request(Stand::Wall, vec![shop.filing_cabinet()]));
    requests.push(request(Stand::Corner, vec![shop.plant()]));
    if home != HomeKind::Office {
        requests.push(request(Stand::Corner, vec![shop.sofa(1)]));
    }
    requests
}

fn corridor(room: &Room, shop: &mut Workshop<'_>) -> Vec<Request> {
    let [w, d] = room.rect.size();
    let mut requests = Vec::new();
    for _ in 0..(w.max(d) / 4.0) as usize {
        requests.push(request(Stand::Wall, vec![shop.plant()]));
        let width = shop.between(0.7, 1.0);
        requests.push(request(Stand::Wall, vec![shop.chest(width, 4)]));
    }
    requests
}

fn open_plan(area: f32, shop: &mut Workshop<'_>) -> Vec<Request> {
    let mut requests = Vec::new();
    for i in 0..(area / 18.0) as usize {
        let islands = if i % 2 == 0 {
            vec![shop.desk_island(3), shop.desk_island(2)]
        } else {
            vec![shop.desk_island(2)]
        };
        requests.push(request(Stand::Middle, islands));
    }
    requests.push(request(Stand::Wall, vec![shop.lounge(2)]));
    for _ in 0..4 {
        requests.push(request(Stand::Wall, vec![shop.bookshelf(), shop.chest(1.6, 3)]));
        requests.push(request(Stand::Wall, vec![shop.filing_cabinet()]));
        requests.push(request(Stand::Wall, vec![shop.plant()]));
    }
    requests
}

fn meeting(area: f32, shop: &mut Workshop<'_>) -> Vec<Request> {
    let tables = if area > 20.0 {
        vec![shop.meeting_set(4), shop.meeting_set(3), shop.meeting_set(2)]
    } else {
        vec![shop.meeting_set(3), shop.meeting_set(2)]
    };
    vec![
        request(Stand::Middle, tables),
        request(Stand::Wall, vec![shop.television()]),
        request(Stand::Corner, vec![shop.plant()]),
        request(Stand::Wall, vec![shop.chest(1.2, 3)]),
    ]
}
