-- The audit log of the first layout, as the program before the signed heads made it (sqlite3 .dump and its marks).
PRAGMA application_id = 1684365685;
PRAGMA user_version = 1;
BEGIN TRANSACTION;
CREATE TABLE audit (id INTEGER PRIMARY KEY, time REAL NOT NULL, kind TEXT NOT NULL, who TEXT NOT NULL,
    reason TEXT NOT NULL, detail TEXT NOT NULL, hash BLOB NOT NULL);
INSERT INTO "audit" VALUES(1,1700000000.0,'armed','Ada','loop test','{"until": 1700003600.0, "via": "command"}',X'EEA519BCE8F4115D1866552AD42EC8107517104E0EF76A2DC617629D32C162E6');
INSERT INTO "audit" VALUES(2,1700000001.0,'write','Ada','','{"sequence": 1, "validity": 31, "words": "000100010001000100010001000100010001000100010001000100010001000100010001000100010001000100010001"}',X'CE9054B15DB41AF99183CDDECA6609D7121741B0775B4593530BB3F805020601');
INSERT INTO "audit" VALUES(3,1700000001.0,'write failed','Ada','no reply within 0.5 s','{"sequence": 1}',X'77F8AA3B6AD23008B2DB541C017695AF9AF4EE24EED751214D2B53C394A12E9E');
INSERT INTO "audit" VALUES(4,1700000002.0,'refused by the PLC','PLC','the CRC is wrong: µ','{"blocks": 1, "sequence": 1}',X'51A6E6E34C94920F0A2E4751758D06BFAB0D459B76B97DE0742FE1A11B050315');
CREATE INDEX audit_by_kind ON audit (kind, id);
CREATE TRIGGER audit_no_change BEFORE UPDATE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END;
CREATE TRIGGER audit_no_loss BEFORE DELETE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END;
CREATE TRIGGER audit_in_order BEFORE INSERT ON audit WHEN NEW.id IS NOT (SELECT coalesce(max(id), 0) + 1 FROM audit)
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END;
COMMIT;
